"""What the documentation shows is executed here: docstring examples, the README's Python, shipped data."""

from __future__ import annotations

import doctest
import importlib
import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

import msb
from data_stubs.make import splat_like_asset
from tests.conftest import ROOT

if TYPE_CHECKING:
    from pathlib import Path

WITH_EXAMPLES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    for path in (ROOT / "msb").rglob("*.py")
    if ">>>" in path.read_text()
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_docstring_examples_give_what_they_show(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


def test_readme_python_runs(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks
    (tmp_path / "data_stubs").symlink_to(ROOT / "data_stubs")
    for block in blocks:
        done = subprocess.run(
            [sys.executable, "-c", block], capture_output=True, text=True, cwd=tmp_path, check=False
        )
        assert done.returncode == 0, done.stderr


def test_readme_links_lead_somewhere() -> None:
    for name in ("README.md", "CONTRIBUTING.md"):
        text = (ROOT / name).read_text()
        for target in re.findall(r"\]\(([^)#:]+)\)", text):
            assert (ROOT / target).exists(), f"{name}: {target}"


def test_shipped_asset_is_what_its_script_makes(tmp_path: Path) -> None:
    msb.save(splat_like_asset(), tmp_path / "again.triasset")
    shipped = ROOT / "data_stubs" / "splat_like.triasset"
    assert (tmp_path / "again.triasset").read_bytes() == shipped.read_bytes()


def test_no_module_is_too_long_to_hold_in_mind() -> None:
    reasons = {"msb/errors.py": "one table of all codes"}
    for folder in ("msb", "tests", "benchmarks", "data_stubs", "docs"):
        for path in (ROOT / folder).rglob("*.py"):
            name = path.relative_to(ROOT).as_posix()
            lines = len(path.read_text().splitlines())
            assert lines <= 400 or name in reasons, f"{name} has {lines} lines"
