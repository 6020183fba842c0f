"""The mechanics alone, as in a notebook: the example of the documentation runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "mechanics.md"


def test_the_example_of_the_documentation_runs_as_it_stands() -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for block in blocks:
        names: dict[str, Any] = {}
        exec(block.replace("print(", "printed = ("), names)
    assert names["done"].choice.contact.name == "l2"
    assert 0.0 < names["done"].contrast_n_m[0] < names["done"].peak_n_m[0]
    assert np.all(np.diff(names["done"].peak_n_m) > 0.0)
