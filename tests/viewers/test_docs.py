"""What the viewers' documentation shows is executed; modules stay short."""

from __future__ import annotations

import doctest
import importlib
import re
import shlex
from typing import Any

import pytest
import typer

from msb_viewers.deployment.state import HELP as COMPARE_HELP
from msb_viewers.palette import STYLES
from msb_viewers.state import HELP
from tests.conftest import ROOT

FOLDER = ROOT / "viewers" / "msb_viewers"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(FOLDER.parent).with_suffix("").parts)
    for path in FOLDER.rglob("*.py")
    if ">>>" in path.read_text()
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_docstring_examples_give_what_they_show(module: str) -> None:
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0
    assert result.failed == 0


def test_no_module_is_too_long_to_hold_in_mind() -> None:
    for path in (*FOLDER.rglob("*.py"), *FOLDER.rglob("*.js")):
        assert len(path.read_text().splitlines()) <= 400, path.name


def test_the_guide_names_every_layer_key_and_option() -> None:
    text = (ROOT / "docs" / "viewer.md").read_text()
    for kind, style in STYLES.items():
        assert f"| {style.key} | `{kind}` |" in text
    for key, _ in (*HELP, *COMPARE_HELP):
        assert f"| {key} |" in text, key
    known = {
        option
        for name in ("view", "compare")
        for option in re.findall(r"--[a-z]+", _command(name).get_help(typer.Context(_command(name))))
    }
    told = set(re.findall(r"--[a-z]+", text)) - {"--view"}  # of msb-audit
    assert told <= known
    shared = {"--force", "--quiet", "--verbose", "--log", "--color", "--debug", "--help"}  # docs/cli.md
    assert known - shared <= told, "the guide does not tell of these options"


def _command(name: str) -> Any:
    from typer.main import get_command

    from msb.cli.app import app

    return get_command(app).commands[name]  # type: ignore[attr-defined]


def test_the_guides_commands_are_put_rightly() -> None:
    text = (ROOT / "docs" / "viewer.md").read_text()
    found = 0
    for line in "\n".join(re.findall(r"```console\n(.*?)```", text, re.DOTALL)).splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["msb"]:
            continue
        _command(words[1]).make_context(words[1], words[2:], resilient_parsing=False).close()
        found += 1
    assert found >= 6
