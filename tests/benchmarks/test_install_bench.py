"""What ``benchmarks/install.py`` counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.install import downloaded_mb, tree_mb


def test_what_pip_says_it_has_downloaded_is_summed(tmp_path: Path) -> None:
    (tmp_path / "palp.whl").write_bytes(bytes(2_000_000))
    said = f"""Processing {tmp_path}/palp.whl
Collecting numpy
  Downloading numpy-2.0-cp313-cp313-manylinux_2_27.whl (16.6 MB)
  Downloading https://index/annotated_doc-0.0.7-py3-none-any.whl.metadata (500 bytes)
Downloading typer-0.29.2-py3-none-any.whl (250 kB)
"""
    assert downloaded_mb(said) == pytest.approx(18.8505)


def test_a_folders_size_counts_files_and_no_link_twice(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "a").write_bytes(bytes(2000))
    (tmp_path / "b").symlink_to(tmp_path / "deep" / "a")
    assert 0.002 <= tree_mb(tmp_path) < 0.0025
