"""Fixtures that run commands and return exit status, standard output and standard error."""

import contextlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest
from typer.main import get_command

from msb.cl.devices import Tried, try_devices
from msb.cli.app import app
from msb.cli.commands import listed
from msb.cli.process import run as run_here
from msb.meshes import Mesh, write_mesh
from tests.cli.forks import run_msb
from tests.conftest import ROOT

INSTALLED = [name for entries in listed().values() for name in entries]
"""The installed commands, in the order of the help."""


def of_installed(*lines: str) -> list[str]:
    """Return the command lines of installed commands."""
    return [line for line in lines if line.split()[0] in INSTALLED]


@dataclass(frozen=True)
class Result:
    """The exit status and the output of a command."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """The JSON document on standard output."""
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"bare {name} in JSON"))

    def ends(self, status: int, begin: str) -> None:
        """Check the status. Check that the only output is a line on standard error with this beginning."""
        assert (self.status, self.out, self.err.count("\n")) == (status, "", 1), self
        assert self.err.startswith(begin), self


Refused = Callable[[str | list[str]], str]
Here = Callable[..., Result]


class Msb(Protocol):
    """Run a command. The first argument can have several words: ``msb("audit --json -", path)``.

    The exit status must be `status`, if it is given.
    """

    def __call__(self, *args: object, status: int | None = None, cwd: Path = ROOT, **env: str) -> Result: ...


@pytest.fixture(scope="session")
def msb() -> Msb:
    """Return a function that runs `msb` with the given arguments."""

    def run(*args: object, status: int | None = None, cwd: Path = ROOT, **env: str) -> Result:
        clean = dict.fromkeys(("NO_COLOR", "FORCE_COLOR", "COLUMNS"))
        first, *rest = map(str, args or ("",))
        done = run_msb([*shlex.split(first), *rest], cwd, {**clean, **env})
        result = Result(done.returncode, done.stdout.decode(), done.stderr.decode())
        assert status in (None, result.status), result
        return result

    return run


def mesh_file(path: Path, points: np.ndarray, faces: np.ndarray) -> Path:
    """Write a mesh in the format of the suffix of `path`; return `path`."""
    write_mesh(Mesh(points, faces.astype(np.int64)), path, suffix=path.suffix)
    return path


def on_terminal(*args: object) -> str:
    """Run `msb` in a process with a terminal, check that it succeeds, and return its output."""
    import pty

    clean = {key: value for key, value in os.environ.items() if key not in {"NO_COLOR", "FORCE_COLOR"}}
    main, side = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "msb", *map(str, args)],
        stdin=subprocess.DEVNULL,
        stdout=side,
        stderr=side,
        cwd=ROOT,
        env={**clean, "TERM": "xterm-256color", "COLUMNS": "100"},
    )
    os.close(side)
    data = b""
    with contextlib.suppress(OSError):  # the message ends with the error text of Linux
        while part := os.read(main, 65536):
            data += part
    os.close(main)
    assert process.wait(60) == 0
    return data.decode()


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    """Return a function like `Msb` that runs `msb` in this process. This is ten times as fast."""
    group = get_command(app)
    monkeypatch.setattr("typer.main.get_command", lambda _: group)

    def run(*args: object, status: int | None = None) -> Result:
        first, *rest = map(str, args or ("",))
        monkeypatch.setattr(sys, "argv", ["msb", *shlex.split(first), *rest])
        capsys.readouterr()
        result = Result(run_here(app, "msb"), *capsys.readouterr())
        assert status in (None, result.status), result
        return result

    return run


@pytest.fixture
def refused(here: Here) -> Refused:
    """Return a function that runs a command in this process, checks for status 2, and returns the error
    line.
    """

    def line_of(line: str | list[str]) -> str:
        result = here(*(shlex.split(line) if isinstance(line, str) else line))
        assert (result.status, result.out, result.err.count("\n")) == (2, "", 1), result
        return result.err.rstrip()

    return line_of


@pytest.fixture(scope="session")
def tried() -> list[Tried]:
    """The results of trying all devices."""
    return try_devices()


@pytest.fixture
def devices(here: Here, tried: list[Tried], monkeypatch: pytest.MonkeyPatch) -> Here:
    """Return a function that runs `msb devices` in this process with the results of `tried`."""
    monkeypatch.setattr("msb.cl.devices.try_devices", lambda: tried)
    for variable in ("MSB_DEVICE", "PYOPENCL_CTX"):
        monkeypatch.setenv(variable, "")
    return lambda *args: here("devices", *args)
