"""The cache of set-ups: hits, versions, damage, parallel runs, places that cannot be written to."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import numpy as np
import pytest

from palp_core.palpation.mechanics.contact import cache
from palp_core.palpation.mechanics.contact.cache import cached
from palp_core.user_folders import cache_folder


@pytest.fixture(autouse=True)
def own_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PALP_CACHE", str(tmp_path / "own"))
    return tmp_path / "own"


def count_into(path: Path) -> cache.Arrays:
    with path.open("ab") as file:
        file.write(b"x")
    return {"a": np.arange(3.0)}


def ask(path: Path, start: object) -> None:
    start.wait()  # type: ignore[attr-defined]
    cached("kind", {"depth_m": 0.1}, lambda: count_into(path))


def test_the_second_time_nothing_is_computed(tmp_path: Path, own_place: Path) -> None:
    for _ in range(3):
        found = cached("kind", {"depth_m": 0.1}, lambda: count_into(tmp_path / "count"))
        assert np.array_equal(found["a"], [0.0, 1.0, 2.0])
    assert (tmp_path / "count").stat().st_size == 1
    assert [path.suffix for path in own_place.glob("*z")] == [".npz"]
    assert not list(own_place.glob("*.part"))


@pytest.mark.parametrize("inputs", [{"depth_m": 0.2}, {"depth_m": np.nextafter(0.1, 1)}, {"other_m": 0.1}])
def test_other_inputs_are_another_entry(tmp_path: Path, inputs: dict[str, float]) -> None:
    cached("kind", {"depth_m": 0.1}, lambda: count_into(tmp_path / "count"))
    cached("kind", {k: float(v) for k, v in inputs.items()}, lambda: count_into(tmp_path / "count"))
    assert (tmp_path / "count").stat().st_size == 2


def test_other_code_is_another_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cached("kind", {}, lambda: count_into(tmp_path / "count"))
    monkeypatch.setattr(cache, "code", lambda: b"changed")
    cached("kind", {}, lambda: count_into(tmp_path / "count"))
    assert (tmp_path / "count").stat().st_size == 2


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "rubbish"])
def test_a_damaged_entry_is_computed_again(tmp_path: Path, own_place: Path, damage: str) -> None:
    cached("kind", {}, lambda: count_into(tmp_path / "count"))
    (entry,) = own_place.glob("*.npz")
    data = bytearray(entry.read_bytes())
    data[len(data) // 3] ^= 0xFF
    broken = {"truncated": bytes(data[:40]), "flipped": bytes(data), "empty": b"", "rubbish": b"no archive"}
    entry.write_bytes(broken[damage])
    for _ in range(2):
        assert np.array_equal(cached("kind", {}, lambda: count_into(tmp_path / "count"))["a"], np.arange(3.0))
    assert (tmp_path / "count").stat().st_size == 2


def test_processes_that_ask_together_compute_once(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    start = context.Event()
    asking = [context.Process(target=ask, args=(tmp_path / "count", start)) for _ in range(6)]
    for process in asking:
        process.start()
    start.set()
    for process in asking:
        process.join()
        assert process.exitcode == 0
    assert (tmp_path / "count").stat().st_size == 1


def test_a_place_that_cannot_be_written_to_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PALP_CACHE", str(tmp_path / "file"))
    for _ in range(2):
        assert "a" in cached("kind", {}, lambda: count_into(tmp_path / "count"))
    assert (tmp_path / "count").stat().st_size == 2


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("PALP_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "palp"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "palp"


def test_a_failed_computation_leaves_nothing_and_frees_its_lock(tmp_path: Path, own_place: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        cached("kind", {}, lambda: {"a": np.array(1 / 0)})
    assert not list(own_place.glob("*.npz"))
    assert "a" in cached("kind", {}, lambda: count_into(tmp_path / "count"))
