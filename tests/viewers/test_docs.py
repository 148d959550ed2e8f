"""The guide to the viewers tells of all that they take."""

from __future__ import annotations

import re
from typing import Any

import typer

from msb_viewers.deployment.state import HELP as COMPARE_HELP
from msb_viewers.palette import REPAIR_STYLES, STYLES
from msb_viewers.state import HELP
from tests.conftest import ROOT


def test_the_guide_names_every_layer_key_and_option() -> None:
    text = (ROOT / "docs" / "viewer.md").read_text()
    for kind, style in (STYLES | REPAIR_STYLES).items():
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
