"""The examples of CONTRIBUTING.md pass `make lint`, and the paths and tests that it names exist."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, of_the_whole
from tests.test_docs_commands import blocks

PLACES = {"FORMAT =": "msb/meshes/tri.py", "check_format(": "tests/meshes/test_tri.py",
          "MAE =": "msb/metrics/mae.py", "check_metric(": "tests/metrics/test_mae.py"}  # fmt: skip


def examples() -> dict[str, str]:
    """Return the examples that CONTRIBUTING.md prints, by their place in the repository."""
    texts = blocks("CONTRIBUTING.md", "python")
    return {place: next(text for text in texts if sign in text) for sign, place in PLACES.items()}


def test_the_examples_pass_ruff(tmp_path: Path) -> None:
    assert len(blocks("CONTRIBUTING.md", "python")) == len(PLACES)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for folder in ("msb", "tests"):  # ruff searches for the imported modules
        for path in (ROOT / folder).rglob("*.py"):
            place = tmp_path / path.relative_to(ROOT)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.touch()
    for place, text in examples().items():
        (tmp_path / place).write_text(text)
    for words in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *words, "--no-cache", *PLACES.values()],
            text=True, cwd=tmp_path, capture_output=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_examples_pass_mypy(tmp_path: Path) -> None:
    for place, text in examples().items():
        if place.startswith("msb/"):
            (tmp_path / Path(place).name).write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", ROOT / "pyproject.toml", *tmp_path.glob("*.py")],
        text=True, cwd=ROOT, capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


@of_the_whole
def test_the_paths_of_the_tables_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| .* \|$", text.partition("## Where to add things")[2].partition("\n## ")[0], re.MULTILINE
    )
    named = {path for row in rows for path in re.findall(r"`((?:msb|tests|docs)/[\w/.]+)`", row)}
    assert len(named) > 20
    assert not [path for path in named if "NAME" not in path and not (ROOT / path).exists()]
