"""Explanations: one for every number there is, found by any of its names, and printed in the manual."""

from __future__ import annotations

from dataclasses import fields

import pytest

from msb import audit
from msb.errors import UsageError
from msb.topology.audit import Metrics
from msb.topology.explain import EXPLANATIONS, explain
from msb.topology.findings import Counts
from tests.conftest import BOOK
from tests.topology.meshes import COUNT_OF, METRIC_OF

KEYS = [f.name for kind in (Counts, Metrics) for f in fields(kind)]


@pytest.mark.parametrize("key", sorted(set(KEYS)))
def test_every_count_and_metric_is_explained(key: str) -> None:
    entry = explain(key)
    assert entry.name == key
    for text in (entry.title, entry.formula, entry.definition, entry.matters, entry.source):
        assert len(text) > 1
    assert "\n" not in entry.formula


def test_every_variant_is_explained_by_its_path() -> None:
    for term, readings in audit(*BOOK).variants().items():
        for reading in readings:
            explain(f"variants.{term}.{reading}")
    assert explain("variants.components.manifold_edges_only").name == "components_manifold_edges"
    assert explain("variants.nonmanifold_vertices.strict").name == "nonmanifold_vertices"


@pytest.mark.parametrize(
    ("symbol", "key"), [*COUNT_OF.items(), *METRIC_OF.items(), ("E_max_faces", "max_edge_faces")]
)
def test_symbol_finds_its_key(symbol: str, key: str) -> None:
    assert explain(symbol).name == key


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("VF_RATIO", "vf_ratio"),
        ("vf-ratio", "vf_ratio"),
        (" vf_ratio ", "vf_ratio"),
        ("metrics.vf_ratio", "vf_ratio"),
        ("counts.edges", "edges"),
        ("welded.metrics.vf_ratio", "vf_ratio"),
        ("e_GT2", "nonmanifold_edges"),
        ("e", "edges"),
        ("LCC_area", "largest_component_area"),
        ("lcc_area", "lcc_area_ratio"),
        ("Lcc_Area", "lcc_area_ratio"),  # neither symbol: the paper's column
    ],
)
def test_case_hyphens_and_paths_do_not_matter(name: str, key: str) -> None:
    assert explain(name).name == key


def test_no_two_entries_share_a_name() -> None:
    names = [n for e in EXPLANATIONS.values() for n in {e.name, e.symbol, *e.aliases} if n]
    assert len(names) == len(set(names))


def test_unknown_name_lists_the_nearest() -> None:
    with pytest.raises(UsageError, match=r"NAME_UNKNOWN: .*edge_ratio"):
        explain("nonmanifold_edge_ration")
    for name in ("???", ""):
        with pytest.raises(UsageError, match="NAME_UNKNOWN"):
            explain(name)
