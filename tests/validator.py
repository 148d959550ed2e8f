"""The official glTF-Validator, which checks every GLB that a test writes for errors and warnings.

`make engines` installs it in .engines. Without the validator the files are not checked, and the test of the
validator is skipped.
"""

import io
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

from msb.meshes.formats import OURS

WRITTEN = "MSB_TEST_GLBS"
"""Environment variable with the folder to which tests and their processes copy the GLB files they write."""
PACKAGE = Path(__file__).parent.parent / ".engines" / "node_modules" / "gltf-validator"


def missing() -> str | None:
    """Return the reason why the validator cannot be used, or None."""
    if shutil.which("node") is None:
        return "Node.js is not installed"
    return None if PACKAGE.is_dir() else "glTF-Validator is not installed; run make engines"


class Validator:
    """A process that validates files. `written` is the folder of files to check."""

    def __init__(self, written: Path) -> None:
        self.written = written
        self._process: subprocess.Popen[bytes] | None = None

    def problems(self, glb: bytes) -> list[str]:
        """Return the errors and warnings of a file."""
        if self._process is None:
            command = ["node", str(Path(__file__).with_suffix(".js")), str(PACKAGE)]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(len(glb).to_bytes(4, "little") + glb)
        self._process.stdin.flush()
        problems: list[str] = json.loads(self._process.stdout.readline())
        return problems

    def judge_written(self) -> dict[str, list[str]]:
        """Return the problems of the invalid files in `written` by file name, and delete all files in it."""
        by_name = {}
        for path in self.written.glob("*.glb"):
            if problems := self.problems(path.read_bytes()):
                by_name[path.name] = problems
            path.unlink()
        return by_name

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None


def keep_written(folder: Path) -> None:
    """Copy every GLB that this process or its forks write from now on to `folder`."""
    form = OURS[".glb"]
    plain = form.write
    assert plain is not None

    def write(mesh: Any, stream: Any, *more: Any) -> None:
        plain(mesh, stream, *more)
        again = io.BytesIO()
        plain(mesh, again, *more)
        part = folder / f"{uuid4()}.part"
        part.write_bytes(again.getvalue())
        part.rename(part.with_suffix(".glb"))  # incomplete files of killed processes keep the ending .part

    OURS[".glb"] = replace(form, write=write)
