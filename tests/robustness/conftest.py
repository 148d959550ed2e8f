"""Fixtures: a full disk, a read-only folder, and a process without root's privileges on files."""

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
_DROP_PRIVILEGES = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner")
"""Root ignores file permissions; a process started by this command respects them."""


@dataclass(frozen=True)
class Disk:
    """A small file system in memory."""

    folder: Path

    def resize(self, size: str) -> None:
        """Change the size of the disk, for example to "8m"."""
        subprocess.run(["mount", "-o", f"remount,size={size}", self.folder], check=True)

    def fill(self) -> None:
        """Write a file until the disk is full."""
        with (self.folder / "filling").open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                return


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """A disk of 64 KiB; the test is skipped if mounting is not allowed."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("mount is not installed")
    if done.returncode:
        pytest.skip(f"mounting a small disk is not allowed: {done.stderr.decode().strip()}")
    yield Disk(folder)
    subprocess.run(["umount", folder], check=True)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder without write permission."""
    folder = tmp_path / "read_only"
    folder.mkdir()
    folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    yield folder
    folder.chmod(stat.S_IRWXU)


@pytest.fixture
def bound() -> Bound:
    """Return a function that runs Python without root's privileges: exit status, stdout and stderr."""
    if os.name == "nt":
        pytest.skip("permissions are POSIX")
    before: tuple[str, ...] = ()
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root ignores permissions, and setpriv is not installed")
        before = _DROP_PRIVILEGES

    def run(*args: object, **variables: str) -> tuple[int, str, str]:
        line = [*before, sys.executable, *map(str, args)]
        environment = {**os.environ, **variables}
        done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT, env=environment, check=False)
        return done.returncode, done.stdout, done.stderr

    return run
