"""Signals that end a command: no traceback, no temporary file, and exit status 128 + signal."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from msb.base.atomic import is_leftover, remove_leftovers
from tests.conftest import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="signals are POSIX")]
# A background process ignores interrupts, and a process under nohup ignores hang-ups. The command therefore
# restores the default handlers of both signals. Writing is slowed down and creates a file after the first
# piece, so that the signal arrives while data is written. An earlier signal would leave a half-open zipfile,
# and Python would print an error about it.
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
CHECKPOINT = ROOT / "data_stubs" / "checkpoint"


@pytest.mark.parametrize(
    ("form", "number"),
    [
        ("packed", signal.SIGINT),
        ("folder", signal.SIGTERM),
        ("packed", signal.SIGHUP),
        ("folder", signal.SIGKILL),
    ],
)
def test_an_interrupted_export_leaves_no_file(tmp_path: Path, number: signal.Signals, form: str) -> None:
    folder, begun = tmp_path / "out", tmp_path / "begun"
    folder.mkdir()
    line = ["export", "--form", form, CHECKPOINT, folder / "a.triasset", begun]
    command = [sys.executable, "-c", SLOW, *map(str, line)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            until = time.monotonic() + 300
            while not begun.exists() and process.poll() is None and time.monotonic() < until:
                time.sleep(0.01)
            assert begun.exists(), "the export did not begin to write"
            process.send_signal(number)
            _, err = process.communicate(timeout=300)
        finally:
            process.kill()
    if number == signal.SIGKILL:  # only temporary files are left, and they can be removed
        assert all(is_leftover(path.name) for path in folder.iterdir())
        remove_leftovers(folder)
    else:
        assert (process.returncode, err) == (128 + number, "")
    assert not list(folder.iterdir())


def test_an_ignored_signal_stays_ignored() -> None:
    code = (
        "import os, signal, sys\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "import msb.asset\nload = msb.asset.load\n"
        "def hang_up(*args):\n    os.kill(os.getpid(), signal.SIGHUP)\n    return load(*args)\n"
        "msb.asset.load = hang_up\nsys.argv = ['msb', 'info', 'data_stubs/splat_like.triasset']\n"
        "from msb.cli import main\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr) == (0, "")
