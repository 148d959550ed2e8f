"""README and the guides work with an installed wheel in an empty folder, and give the output that they show.

The lines after a command in a ``console`` block are its standard output; ``...`` stands for any text. All
commands of a document run one after the other in the same folder. The Python code of the document runs last.
"""

import doctest
import json
import os
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.slow

DOCUMENTS = ["README.md", *sorted(f"docs/guides/{path.name}" for path in (ROOT / "docs/guides").iterdir())]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

DRIVER = """
import json, sys
root, site, steps = sys.argv[1:]
sys.path = [place for place in sys.path if place not in (root, root + "/viewers")]
from importlib.metadata import distribution
import msb
assert msb.__file__.startswith(site)
programs = {entry.name: entry for entry in distribution("meshsplatbench").entry_points}
for words in json.loads(steps):
    if isinstance(words, str):
        exec(compile(words, "shown", "exec"), {"__name__": "shown"})
    else:
        sys.argv = words
        try:
            programs[words[0]].load()()
        except SystemExit as end:
            if end.code:
                sys.exit(f"{words} ended with {end.code}")
    print(chr(30), end="", flush=True)
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the installed wheel of this tree."""
    pytest.importorskip("hatchling.builders", reason="extra test is not installed (hatchling)")
    from hatchling.builders.wheel import WheelBuilder

    folder = tmp_path_factory.mktemp("site")
    (wheel,) = WheelBuilder(str(ROOT)).build(
        directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"]
    )
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def steps(document: str) -> list[tuple[str, str]]:
    """Return the commands of a document with their output, and all its Python code as the last step."""
    text = (ROOT / document).read_text(encoding="utf-8")
    commands, python = [], []
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if language == "console":
            for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, output = part.partition("\n")
                commands.append((command, output))
        elif language == "python":
            python.append(block)
    return [*commands, *([("\n".join(python), "...\n")] if python else [])]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_documents_work_with_a_wheel_in_an_empty_folder(document: str, site: Path, tmp_path: Path) -> None:
    if "[bench]" in (ROOT / document).read_text(encoding="utf-8"):
        pytest.importorskip("skimage", reason="extra bench is not installed")
    documented = steps(document)
    words = [shlex.split(step) if step.startswith("msb") else step for step, _ in documented]
    done = subprocess.run(
        [sys.executable, "-c", DRIVER, str(ROOT), str(site), json.dumps(words)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "80", "NO_COLOR": "1"},
        timeout=500,
    )
    assert done.returncode == 0, f"{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
    checker = doctest.OutputChecker()
    for (step, expected), printed in zip(documented, done.stdout.split(chr(30))[:-1], strict=True):
        assert checker.check_output(expected, printed, FLAGS), f"{step}\n{expected}\n{printed}"


def test_guides_have_commands_and_name_no_files_of_a_checkout() -> None:
    for document in DOCUMENTS:
        assert steps(document), document
        text = (ROOT / document).read_text(encoding="utf-8")
        assert "data_stubs" not in text, f"{document} names a folder that a wheel lacks"
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 95
