"""A disk that is full, a folder that may not be written into, and somebody whom permissions bind."""

import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.cli.conftest import here
from tests.conftest import ROOT

__all__ = ["here"]

Bound = Callable[..., tuple[int, str, str]]
_LIKE_ANYBODY = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner")
"""For root, whom the system refuses nothing otherwise."""


@dataclass(frozen=True)
class Disk:
    """A file system of its own."""

    folder: Path

    def resize(self, size: str) -> None:
        """Give it another size, say "8m"."""
        subprocess.run(["mount", "-o", f"remount,size={size}", self.folder], check=True)

    def fill(self) -> None:
        """Leave no room."""
        with (self.folder / "filling").open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                return


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """A disk of 64 KiB; skips where mounting one is not allowed."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("there is no mount here")
    if done.returncode:
        pytest.skip(f"mounting a small disk is not allowed here: {done.stderr.decode().strip()}")
    yield Disk(folder)
    subprocess.run(["umount", folder], check=True)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder into which nobody may write."""
    folder = tmp_path / "read_only"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    yield folder
    folder.chmod(stat.S_IRWXU)


@pytest.fixture
def bound() -> Bound:
    """Return a function that runs Python as somebody whom permissions bind: status and both streams."""
    if os.name == "nt":
        pytest.skip("permissions are POSIX")
    before: tuple[str, ...] = ()
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root is refused nothing, and there is no setpriv to change that")
        before = _LIKE_ANYBODY

    def run(*args: object, **variables: str) -> tuple[int, str, str]:
        line = [*before, sys.executable, *map(str, args)]
        environment = {**os.environ, **variables}
        done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
        return done.returncode, done.stdout, done.stderr

    return run
