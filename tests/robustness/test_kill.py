"""Commands killed a few times; `python -m tests.robustness.kill` does it a hundred times each."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.robustness.commands import COMMANDS
from tests.robustness.kill import Killer, Tally

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="process groups are POSIX")]


@pytest.mark.parametrize(
    ("name", "replacing"),
    [("export-folder", True), ("convert", False), ("render", False), ("repair", True), ("trial", True)],
)
def test_nothing_is_half_there_and_it_works_again(tmp_path: Path, name: str, replacing: bool) -> None:
    killer = Killer(COMMANDS[name], tmp_path, size=20, seed=3)
    tally = Tally()
    killer.once(tmp_path / "round", "writing", killer.random.random(), tally, replacing=replacing)
    assert tally.kills + tally.ended == 1


def test_a_half_file_is_found(tmp_path: Path) -> None:
    asset = (ROOT / "data_stubs" / "splat_like.triasset").read_bytes()
    (tmp_path / "a.triasset").write_bytes(asset[: len(asset) // 2])
    with pytest.raises(AssertionError, match="TRIASSET_"):
        Killer.contents(tmp_path)
