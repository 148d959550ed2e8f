"""The method table against the paper's two feature matrices, cell by cell."""

from __future__ import annotations

import json
from typing import Any

import pytest

from msb.registry import METHODS, PASSES, TIERS, Method
from tests.cli.conftest import Msb
from tests.conftest import ROOT

BY_PAPER_NAME = {method.paper_name: method for method in METHODS.values() if method.paper_name}


def cells(table: str) -> list[dict[str, Any]]:
    path = ROOT / "msb" / "report" / "paper_tables" / f"{table}.json"
    found: list[dict[str, Any]] = json.loads(path.read_text())["cells"]
    return found


@pytest.mark.parametrize("cell", cells("method_attributes"), ids=lambda c: f"{c['method']}-{c['attribute']}")
def test_native_attributes_are_the_papers(cell: dict[str, Any]) -> None:
    native = BY_PAPER_NAME[cell["method"]].native
    assert getattr(native, cell["attribute"]) is cell["value"]


@pytest.mark.parametrize(
    "cell", cells("feature_mapping"), ids=lambda c: f"{c['method']}-{c['condition']}-{c['attribute']}"
)
def test_retained_features_are_the_papers(cell: dict[str, Any]) -> None:
    method = BY_PAPER_NAME[cell["method"]]
    kept = method.retained.get(cell["condition"])
    if cell["value"] is None:
        assert kept is None
        assert not method.supports(cell["condition"])
        return
    value = getattr(kept, cell["attribute"])
    assert ("not_applicable" if value is None else value) == cell["value"]


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_tier_is_supported_with_passes_or_refused_with_a_reason(method: Method) -> None:
    for tier in TIERS:
        assert (tier in method.passes) is method.supports(tier)
        assert set(method.passes.get(tier, ())) <= set(PASSES)
    assert all(setting.problem(setting.default) is None for setting in method.settings.values())


def test_command_prints_every_cell(msb: Msb) -> None:
    text = msb("methods", "--format", "markdown").out
    assert "| Triangle-Splatting | Method-aware | yes | yes | yes | yes | SH |" in text
    assert "| MeshSplatting | Method-aware | yes | yes | -- | yes | SH |" in text
    assert "| DiffSoup | Method-aware | yes | yes | -- | yes* | MLP |" in text
    assert "keeps of it (*: depth test)" in text
    assert "| DiffSoup | N/A | N/A |" in text
    assert "| 3DGS | N/A | N/A | N/A | N/A | N/A | N/A |" in text
    assert "| 2DTS | no | yes | no | yes | no | yes |" in text
    data = msb("methods", "--json", "-").json
    assert data["methods"]["two_dts"]["paper_name"] == "2dts"
    assert set(data["methods"]) == set(METHODS)


def test_the_tier_table_says_that_the_standard_tier_reads_opacity_for_a_threshold(msb: Msb) -> None:
    text = msb("methods", "--format", "markdown").out
    assert "| 2DTS | Fallback | baked SH-DC* |" in text
    note = "ste_threshold hides faces by opacity"
    assert f"## What the standard tier keeps of it (*: {note})" in text
    for name, method in METHODS.items():
        kept = method.retained.get("standard")
        assert kept is None or (note in kept.notes.values()) is ("ste_threshold" in method.settings), name
