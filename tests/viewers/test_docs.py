"""What the viewers' documentation shows is executed; modules stay short."""

from __future__ import annotations

import doctest
import importlib
import re
import shlex

import pytest

from msb_viewers.palette import STYLES
from msb_viewers.state import HELP
from tests.conftest import ROOT

FOLDER = ROOT / "viewers" / "msb_viewers"
WITH_EXAMPLES = sorted(path.stem for path in FOLDER.glob("*.py") if ">>>" in path.read_text())


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_docstring_examples_give_what_they_show(module: str) -> None:
    result = doctest.testmod(importlib.import_module(f"msb_viewers.{module}"))
    assert result.attempted > 0
    assert result.failed == 0


def test_no_module_is_too_long_to_hold_in_mind() -> None:
    for path in (*FOLDER.glob("*.py"), *FOLDER.glob("*.js")):
        assert len(path.read_text().splitlines()) <= 400, path.name


def test_the_guide_names_every_layer_key_and_option() -> None:
    text = (ROOT / "docs" / "viewer.md").read_text()
    for kind, style in STYLES.items():
        assert f"| {style.key} | `{kind}` |" in text
    for key, _ in HELP:
        assert f"| {key} |" in text, key
    command = (ROOT / "msb" / "cli" / "view.py").read_text()
    options = set(re.findall(r"--[a-z]+", text)) - {"--view"}  # of msb-audit
    for option in options:
        name = option.removeprefix("--")
        assert option in command or re.search(rf"\n    {name}: Annotated", command), option


def test_the_guides_commands_are_put_rightly() -> None:
    from typer.main import get_command

    from msb.cli.app import app

    text = (ROOT / "docs" / "viewer.md").read_text()
    root = get_command(app)
    found = 0
    for line in "\n".join(re.findall(r"```console\n(.*?)```", text, re.DOTALL)).splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["msb"]:
            continue
        command = root.commands[words[1]]  # type: ignore[attr-defined]
        command.make_context(words[1], words[2:], resilient_parsing=False).close()
        found += 1
    assert found >= 6
