"""Files that `--log-file` appends to, and files that it leaves alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.conftest import Msb, Refused
from tests.conftest import ROOT

ASSET = ROOT / "data_stubs" / "splat_like.triasset"


@pytest.mark.parametrize("force", [(), ("--force",)])
@pytest.mark.parametrize(
    "text", [b"glTF\2\0\0\0", b"ply\nformat ascii 1.0\n", b"\n", b"2024-01-01 10:00 INFO a\n"]
)
def test_a_file_that_is_no_log_is_not_added_to(
    tmp_path: Path, refused: Refused, text: bytes, force: tuple[str, ...]
) -> None:
    (tmp_path / "a.glb").write_bytes(text)
    (tmp_path / "link").symlink_to("a.glb")
    for name in ("a.glb", "link"):
        line = refused(["audit", *force, "--log-file", str(tmp_path / name), str(ASSET)])
        assert line.startswith(f"OUTPUT_EXISTS: {tmp_path / name}: --log-file: ")
    assert (tmp_path / "a.glb").read_bytes() == text


@pytest.mark.slow
def test_a_log_is_added_to_where_there_is_none_an_empty_one_or_one_of_ours(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "log").touch()
    for lines in (1, 2):
        msb("completion", "--log-file", tmp_path / "log", "bash", status=0)
        assert len((tmp_path / "log").read_text().splitlines()) == lines
    (tmp_path / "null").symlink_to(os.devnull)
    msb("completion", "--log-file", tmp_path / "null", "bash", status=0)


def test_an_input_that_is_not_there_is_not_made_by_the_log(tmp_path: Path, refused: Refused) -> None:
    assert refused(f"audit --log-file {tmp_path}/a.ply {tmp_path}/a.ply").startswith("USAGE: ")
    assert list(tmp_path.iterdir()) == []
