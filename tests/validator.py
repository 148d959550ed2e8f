"""The official glTF-Validator, which holds every GLB that a test writes to no error and no warning.

`make engines` brings it into .engines; where it is not, tests write GLB unjudged, and the validator's own
test is skipped.
"""

import io
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

from msb.meshes.files import FORMATS

WRITTEN = "MSB_TEST_GLBS"
"""The variable that names the folder where processes of tests keep what GLB they write."""
PACKAGE = Path(__file__).parent.parent / ".engines" / "node_modules" / "gltf-validator"


def missing() -> str | None:
    """Return why there is no validator here, or None."""
    if shutil.which("node") is None:
        return "Node.js is not installed"
    return None if PACKAGE.is_dir() else "glTF-Validator is not here: make engines"


class Validator:
    """A process that judges one file after the other; it starts with the first.

    `written` is a folder of files that are to be judged.
    """

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
        found: list[str] = json.loads(self._process.stdout.readline())
        return found

    def judge_written(self) -> dict[str, list[str]]:
        """Return the problems of the files that wait; they wait no more."""
        found = {}
        for path in self.written.glob("*.glb"):
            if problems := self.problems(path.read_bytes()):
                found[path.name] = problems
            path.unlink()
        return found

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None


def keep_written(folder: Path) -> None:
    """Keep a copy of every GLB that this process, or a fork of it, writes from now on in `folder`."""
    form = FORMATS[".glb"]
    plain = form.write
    assert plain is not None

    def write(mesh: Any, stream: Any, *more: Any) -> None:
        plain(mesh, stream, *more)
        again = io.BytesIO()
        plain(mesh, again, *more)
        part = folder / f"{uuid4()}.part"
        part.write_bytes(again.getvalue())
        part.rename(part.with_suffix(".glb"))  # none whose writer was killed half-way is judged

    FORMATS[".glb"] = replace(form, write=write)
