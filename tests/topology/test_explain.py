"""Explanations: one for every number there is, found by any of its names, and printed in the manual."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields

import pytest

from docs.make_definitions import PAGE, page
from msb import audit
from msb.errors import UsageError
from msb.topology.audit import Metrics
from msb.topology.explain import EXPLANATIONS, explain
from msb.topology.findings import Counts
from tests.conftest import BOOK, ROOT
from tests.topology.meshes import COUNT_OF, METRIC_OF

KEYS = [f.name for kind in (Counts, Metrics) for f in fields(kind)]
PEERS = {"libigl", "PyMeshLab", "manifold3d", "trimesh", "NetworkX"}


@pytest.mark.parametrize("key", sorted(set(KEYS)))
def test_every_count_and_metric_is_explained(key: str) -> None:
    entry = explain(key)
    assert entry.name == key
    for text in (entry.title, entry.formula, entry.definition, entry.matters, entry.source):
        assert len(text) > 1
    assert "\n" not in entry.formula
    assert entry.definition.endswith(".")
    assert entry.matters.endswith(".")


@pytest.mark.parametrize(
    "key", ["topology", "is_soup", "winding_consistent", "valence_histogram", "variants", "welded"]
)
def test_other_keys_of_the_json_are_explained(key: str) -> None:
    assert key in audit(*BOOK).to_dict()
    assert explain(key).name == key


def test_every_variant_is_explained_by_its_path() -> None:
    for term, readings in audit(*BOOK).variants().items():
        for reading in readings:
            explain(f"variants.{term}.{reading}")
    assert explain("variants.components.manifold_edges_only").name == "components_manifold_edges"
    assert explain("variants.nonmanifold_vertices.strict").name == "nonmanifold_vertices"


@pytest.mark.parametrize(
    ("symbol", "key"), [*COUNT_OF.items(), *METRIC_OF.items(), ("E_max_faces", "max_edge_faces")]
)
def test_symbol_of_the_specification_finds_its_key(symbol: str, key: str) -> None:
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
    with pytest.raises(UsageError, match="nonmanifold_edge_ratio") as caught:
        explain("nonmanifold_edge_ration")
    assert caught.value.code == "EXPLAIN_UNKNOWN"
    with pytest.raises(UsageError, match="the names are vf_ratio, "):
        explain("???")
    with pytest.raises(UsageError):
        explain("")


def test_text_fits_a_terminal_and_names_every_part() -> None:
    for entry in EXPLANATIONS.values():
        text = entry.to_text()
        assert max(map(len, text.splitlines())) <= 80, entry.name
        assert text.startswith(entry.name)
        for word in ("Formula: ", "Why it matters: ", "Source: ", *(f"{peer}: " for peer in entry.peers)):
            assert f"\n{word}" in text
        assert text.isascii()


def test_peers_are_the_five_and_their_texts_say_something() -> None:
    for entry in EXPLANATIONS.values():
        assert set(entry.peers) <= PEERS
        assert all(len(text) >= len("agrees") for text in entry.peers.values())
    assert {peer for entry in EXPLANATIONS.values() for peer in entry.peers} == PEERS


def test_entry_is_json_data() -> None:
    data = json.loads(json.dumps(explain("E_gt2").to_dict()))
    assert data["name"] == "nonmanifold_edges"
    assert data["symbol"] == "E_gt2"


def test_manual_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m docs.make_definitions"


def test_explaining_loads_nothing_heavy() -> None:
    code = "from msb.topology.explain import explain; explain('E'); import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not {"scipy", "trimesh", "igl", "pymeshlab", "networkx", "rich"} & set(done.stdout.split())
