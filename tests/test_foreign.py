"""The boundary to other people's code: their words stay off the screen, palp's own pass."""

from __future__ import annotations

import logging
import threading
import warnings

import pytest

from palp_core.errors import BagError, DeviceError, PalpError
from palp_core.foreign import catch_foreign


@pytest.mark.parametrize(
    ("raised", "text"),
    [
        (RuntimeError("no\n  such port"), "x.mcap: RuntimeError: no such port; try another"),
        (NameError(), "x.mcap: NameError; try another"),
        (
            OSError(2, "No such file", "x"),
            "x.mcap: No such file; try another",
        ),
        (ModuleNotFoundError("gone", name="pyxdf"), "x.mcap: pyxdf is not installed; type: "),
        (ModuleNotFoundError("No module 'canlib'", name="canlib"), "x.mcap: ModuleNotFoundError: No module"),
    ],
)
def test_an_exception_becomes_an_error_of_the_place_with_a_fix(raised: Exception, text: str) -> None:
    with pytest.raises(BagError) as seen, catch_foreign("x.mcap", BagError, "try another"):
        raise raised
    assert str(seen.value).startswith(text)
    assert seen.value.__cause__ is raised


@pytest.mark.parametrize("raised", [DeviceError("ati: no answer"), KeyboardInterrupt(), SystemExit(3)])
def test_palps_own_error_and_an_interruption_pass_as_they_are(raised: BaseException) -> None:
    with pytest.raises(type(raised)) as seen, catch_foreign("x.mcap", BagError):
        raise raised
    assert seen.value is raised


def test_log_lines_and_warnings_are_remarks_once_each_and_nothing_is_printed(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])  # as on the command line
    library = logging.getLogger("pyxdf.pyxdf")
    with catch_foreign("x.xdf", PalpError) as remarks:
        for _ in range(2):
            library.warning("Stream %d: it\n differs", 1)
            warnings.warn("mean of an empty slice", RuntimeWarning, stacklevel=1)
        library.info("loading")
        with catch_foreign("y.xdf", PalpError) as inner:
            library.error("damaged")
        library.error("also damaged")
    assert remarks == ["Stream 1: it differs", "mean of an empty slice", "also damaged"]
    assert inner == ["damaged"]
    assert capfd.readouterr().err == ""


def test_what_a_half_made_object_logs_as_it_goes_is_a_remark(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Bus:
        def __init__(self) -> None:
            raise OSError("no driver")

        def __del__(self) -> None:
            logging.getLogger("can.bus").warning("not shut down")

    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with pytest.raises(DeviceError) as seen, catch_foreign("ati", DeviceError) as remarks:
        Bus()
    assert remarks == ["not shut down"]
    del seen
    assert capfd.readouterr().err == ""


def test_palps_own_words_other_threads_and_what_follows_are_not_kept_back(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OwnWarning(UserWarning):
        __module__ = "palp_core.palpation"

    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with pytest.warns(OwnWarning, match="mine"), catch_foreign("x.xdf", PalpError) as remarks:  # noqa: PT031
        warnings.warn("mine", OwnWarning, stacklevel=1)
        logging.getLogger("palp.estimator").warning("of palp")
        other = threading.Thread(target=lambda: logging.getLogger("can").warning("of another thread"))
        other.start()
        other.join()
    logging.getLogger("can").warning("afterwards")
    assert remarks == []
    assert capfd.readouterr().err.splitlines() == ["of palp", "of another thread", "afterwards"]
