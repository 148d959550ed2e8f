"""Signals that end a command: no traceback, no temporary file, the shell's status for them."""

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
def test_writing_is_broken_off(tmp_path: Path, number: signal.Signals, form: str) -> None:
    folder, begun = tmp_path / "out", tmp_path / "begun"
    folder.mkdir()
    line = ["export", "--form", form, CHECKPOINT, folder / "a.triasset", begun]
    command = [sys.executable, "-c", SLOW, *map(str, line)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            until = time.monotonic() + 300
            while not begun.exists() and process.poll() is None and time.monotonic() < until:
                time.sleep(0.01)
            assert begun.exists(), "it never began to write"
            process.send_signal(number)
            _, err = process.communicate(timeout=300)
        finally:
            process.kill()
    if number == signal.SIGKILL:  # nothing stands under its final name, and what is left can be removed
        assert all(is_leftover(path.name) for path in folder.iterdir())
        remove_leftovers(folder)
    else:
        assert (process.returncode, err) == (128 + number, "")
    assert not list(folder.iterdir())


def test_a_signal_that_is_ignored_stays_so() -> None:
    code = (
        "import os, signal, sys\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "import msb.asset\nload = msb.asset.load\n"
        "def hang_up(*args):\n    os.kill(os.getpid(), signal.SIGHUP)\n    return load(*args)\n"
        "msb.asset.load = hang_up\nsys.argv = ['msb', 'info', 'data_stubs/splat_like.triasset']\n"
        "from msb.cli import main\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert (done.returncode, done.stderr) == (0, "")
