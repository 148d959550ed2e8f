"""Signals that end a command: no traceback, no temporary file, the shell's status for them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.robustness.kill import Killer, finals, leftovers

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")]
# Who is started in the background inherits that interrupts are ignored, under nohup hang-ups, too. Writing
# is made slow, and says when it is in the middle, so that the signal comes there: not a moment earlier, when
# zipfile has made half an archive, of which Python complains by itself.
SLOW = (
    "import pathlib, signal, sys, time\n"
    "begun = pathlib.Path(sys.argv.pop())\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    "import msb.asset.writer\nfrom msb.asset.writer import _pieces\n"
    "def slowly(chunks):\n    for piece in _pieces(chunks):\n"
    "        yield piece\n        begun.touch()\n        time.sleep(600)\n"
    "msb.asset.writer._pieces = slowly\n"
    "from msb.cli import main\nmain()"
)


@pytest.mark.parametrize(
    ("name", "replacing"), [("export-folder", True), ("convert", False), ("render", False)]
)
def test_a_killed_command_leaves_nothing_half_and_works_again(
    tmp_path: Path, name: str, replacing: bool
) -> None:
    """Once here; `python -m tests.robustness.kill` does it a hundred times."""
    killer = Killer(name, tmp_path, size=20, seed=3)
    tally = killer.once("writing", killer.random.random(), replacing=replacing)
    assert tally["killed"] + tally["ended"] == 1


@pytest.mark.parametrize(
    ("form", "number"),
    [("packed", signal.SIGINT), ("folder", signal.SIGTERM), ("packed", signal.SIGHUP)],
)
def test_writing_is_broken_off(tmp_path: Path, number: signal.Signals, form: str) -> None:
    folder, begun = tmp_path / "out", tmp_path / "begun"
    folder.mkdir()
    line = ["export", "--form", form, ROOT / "data_stubs" / "checkpoint", folder / "a.triasset", begun]
    command = [sys.executable, "-c", SLOW, *map(str, line)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            until = time.monotonic() + 300
            while not begun.exists() and process.poll() is None and time.monotonic() < until:
                time.sleep(0.01)
            assert begun.exists(), "it never began to write"
            assert leftovers(folder)
            process.send_signal(number)
            _, err = process.communicate(timeout=300)
        finally:
            process.kill()
    assert (process.returncode, err) == (128 + number, "")
    assert not leftovers(folder)
    assert not list(finals(folder))


@pytest.mark.parametrize(("raised", "status"), [("KeyboardInterrupt", 130), ("SystemExit(143)", 143)])
def test_what_objects_to_being_closed_does_not_hide_why(raised: str, status: int) -> None:
    code = (
        "import sys\nimport msb.api.commands.info as info\nimport msb.asset\n"
        f"def load(*args):\n    try:\n        raise {raised}\n"
        "    finally:\n        raise ValueError('open')\n"
        "msb.asset.load = load\nsys.argv = ['msb', 'info', 'data_stubs/splat_like.triasset']\n"
        "from msb.cli import main\nsys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr) == (status, "")


def test_a_signal_that_is_ignored_stays_so(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "import msb.api.commands.info as info\nimport msb.asset\nload = msb.asset.load\n"
        "def hang_up(*args):\n    os.kill(os.getpid(), signal.SIGHUP)\n    return load(*args)\n"
        "msb.asset.load = hang_up\nsys.argv = ['msb', 'info', 'data_stubs/splat_like.triasset']\n"
        "from msb.cli import main\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr) == (0, "")
