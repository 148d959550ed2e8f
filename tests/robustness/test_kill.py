"""Commands killed a few times; `python -m tests.robustness.kill` does it a hundred times each."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from tests.conftest import ROOT
from tests.robustness import kill
from tests.robustness.commands import COMMANDS
from tests.robustness.kill import Killer, Tally
from tests.robustness.whole import leftovers

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(os.name == "nt", reason="process groups are POSIX")


@pytest.mark.parametrize(
    ("name", "replacing"), [("export-folder", True), ("convert", False), ("render", False)]
)
def test_nothing_is_half_there_and_it_works_again(tmp_path: Path, name: str, replacing: bool) -> None:
    killer = Killer(COMMANDS[name], tmp_path, size=20, seed=3)
    tally = Tally()
    killer.once(tmp_path / "round", "writing", killer.random.random(), tally, replacing=replacing)
    assert tally.kills + tally.ended == 1


def test_what_vanishes_while_it_is_looked_for_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = ".a.triasset.0123456789ab.part"
    for name in (part, "a.triasset"):
        (tmp_path / name / "buffers").mkdir(parents=True)
    scan = os.scandir

    def vanished(path: str | os.PathLike[str]) -> Any:
        if os.fspath(path) != os.fspath(tmp_path):
            raise FileNotFoundError(2, "No such file or directory", os.fspath(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", vanished)
    assert leftovers(tmp_path) == [tmp_path / part]


class Sleeper(Killer):
    """Kills what does nothing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def start(self, place: Path, *, force: bool = False) -> subprocess.Popen[bytes]:
        code = "import time; time.sleep(600)"
        self.started = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
        return self.started


def test_a_look_that_fails_leaves_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_folder: Path) -> list[Path]:
        raise PermissionError

    monkeypatch.setattr(kill, "leftovers", broken)
    sleeper = Sleeper(tmp_path)
    with pytest.raises(PermissionError):
        sleeper.once(tmp_path / "round", "writing", 0.5, Tally(), replacing=False)
    assert sleeper.started.returncode == -signal.SIGKILL


def test_a_half_file_is_found(tmp_path: Path) -> None:
    asset = (ROOT / "data_stubs" / "splat_like.triasset").read_bytes()
    (tmp_path / "a.triasset").write_bytes(asset[: len(asset) // 2])
    with pytest.raises(AssertionError, match="TRIASSET_"):
        Killer.contents(tmp_path)
