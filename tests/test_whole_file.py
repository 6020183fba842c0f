"""A file is there whole, or not at all."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from palp_core.graph.bag.writer import BagWriter
from palp_core.whole_file import read_whole, whole_file, write_json, write_whole


def test_a_file_that_fails_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    write_whole(tmp_path / "file", "before")
    with pytest.raises(TypeError), whole_file(tmp_path / "file") as file:
        file.writelines([b"half", "no bytes"])  # type: ignore[list-item]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "before"


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_takes_its_name_when_it_is_complete(tmp_path: Path, durable: bool) -> None:
    with whole_file(tmp_path / "file", durable=durable) as file:
        file.write("grün".encode())
        assert not (tmp_path / "file").exists()
    assert (tmp_path / "file").read_text(encoding="utf-8") == "grün"


def test_a_secret_is_closed_to_others_before_a_byte_is_in_it(tmp_path: Path) -> None:
    with whole_file(tmp_path / "secret", mode=0o600) as file:
        assert os.fstat(file.fileno()).st_mode & 0o777 == 0o600
    assert (tmp_path / "secret").stat().st_mode & 0o777 == 0o600


def test_what_a_dead_process_of_the_same_number_has_left_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / f".file.{os.getpid()}.part").write_text("left")
    write_whole(tmp_path / "file", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_json_has_null_where_there_is_no_number(tmp_path: Path) -> None:
    write_json(tmp_path / "file.json", {"rmse_m": float("nan")})
    assert (tmp_path / "file.json").read_text() == '{\n "rmse_m": null\n}\n'


def test_a_durable_file_is_on_the_disk_with_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[bool] = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(stat.S_ISDIR(os.fstat(handle).st_mode)))
    write_whole(tmp_path / "file", "plain")
    assert synced == []
    write_whole(tmp_path / "file", "durable", durable=True)
    assert synced == [False, True]


def test_the_description_of_a_finished_bag_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    monkeypatch.setattr(
        os, "fsync", lambda handle: synced.append(Path(f"/proc/self/fd/{handle}").readlink().name)
    )
    BagWriter(tmp_path / "run").close()
    assert [name for name in synced if "metadata" in name] == [f".metadata.yaml.{os.getpid()}.part"]
    assert synced[-1] == "run"


def test_a_pipe_is_written_and_stays_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole(pipe, "new")
        assert os.read(reader, 10) == b"new"
    finally:
        os.close(reader)
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_what_a_link_leads_to_is_replaced_and_not_the_link(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link, file = tmp_path / "link", tmp_path / "there" / "file"
    link.symlink_to(file)
    write_whole(link, "new")
    assert link.is_symlink()
    assert file.read_text() == "new"


ENDLESS = {
    "/dev/zero": "it is a device, not a file",
    "pipe": "it is a pipe, not a file",
    "folder": "it is a folder, not a file",
    "sparse": "it has more than 128 MiB",
    "/proc/self/maps": "it has more than 1 KiB",  # it states a size of 0
}


@pytest.mark.parametrize("name", ENDLESS)
def test_what_has_no_end_is_not_read(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(5 << 30)
    with pytest.raises(OSError, match="it ") as caught:
        read_whole(tmp_path / name, *([1 << 10] if name.startswith("/proc") else []))
    assert caught.value.strerror == ENDLESS[name]


def test_a_file_of_just_the_size_is_read_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_whole(tmp_path / "link", 5) == b"12345"
