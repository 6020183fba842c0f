"""Two sessions never write into one folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session.trials_csv import SessionWriter


def test_a_second_session_is_refused_until_the_first_has_closed(tmp_path: Path) -> None:
    first, second = SessionWriter(str(tmp_path), [0.002]), SessionWriter(str(tmp_path), [0.002])
    first.start()
    with pytest.raises(PalpError, match="another session is writing"):
        second.start()
    first.close()
    second.start()
    second.close()
