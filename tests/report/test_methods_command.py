"""The method table against the paper's two feature matrices, cell by cell."""

import json
from typing import Any

import pytest

from msb.registry import METHODS, PASSES, TIERS, Method
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]

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


def rows_of(text: str) -> dict[str, list[list[str]]]:
    """Return method -> its rows in all tables of Markdown."""
    rows: dict[str, list[list[str]]] = {}
    for line in text.splitlines():
        if line.startswith("| "):
            name, *row = [cell.strip() for cell in line.strip("|").split("|")]
            rows.setdefault(name, []).append(row)
    return rows


def test_the_command_prints_every_cell(here: Here) -> None:
    rows = rows_of(here("methods", "--format", "markdown").out)
    assert ["Method-aware", "yes", "yes", "yes", "yes", "SH"] in rows["Triangle-Splatting"]
    assert ["Method-aware", "yes", "yes", "--", "yes", "SH"] in rows["MeshSplatting"]
    assert ["Method-aware", "yes", "yes", "--", "yes*", "MLP"] in rows["DiffSoup"]
    assert any(row[:2] == ["N/A", "N/A"] for row in rows["DiffSoup"])
    assert ["N/A"] * 6 in rows["3DGS"]
    assert any(row[:6] == ["no", "yes", "no", "yes", "no", "yes"] for row in rows["2DTS"])
    assert any(row[:2] == ["Fallback", "baked SH-DC*"] for row in rows["2DTS"])
    data = here("methods", "--json", "-").json
    assert data["methods"]["two_dts"]["paper_name"] == "2dts"
    assert set(data["methods"]) == set(METHODS)


def test_a_threshold_of_opacity_is_noted_where_there_is_one() -> None:
    for name, method in METHODS.items():
        kept = method.retained.get("standard")
        thresholds = kept is not None and any("ste_threshold" in note for note in kept.notes.values())
        assert kept is None or thresholds is ("ste_threshold" in method.settings), name
