"""A mesh and what a repair made of it, as the viewer shows both."""

from pathlib import Path

import numpy as np

from msb_viewers.model import ViewModel
from msb_viewers.page import page
from msb_viewers.palette import ADDED, DELETED, REPAIR_STYLES
from msb_viewers.repaired import build_repaired_model
from msb_viewers.state import ViewState
from msb_viewers.viewed_mesh import ViewedMesh
from tests.conftest import BOOK, TETRAHEDRON


def model_of(before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]) -> ViewModel:
    meshes = (ViewedMesh(f"{name}.ply", Path(name), *mesh) for name, mesh in (("a", before), ("b", after)))
    return build_repaired_model(*meshes)


def counts(model: ViewModel) -> dict[str, int]:
    return {kind: len(layer) for kind, layer in model.layers.items()}


def test_deleted_faces_are_red_added_ones_green_and_all_are_layers_of_the_mesh_as_stored() -> None:
    points, faces = TETRAHEDRON
    points = np.concatenate([points, [[2, 2, 2]]]).astype(np.float32)
    model = model_of((points, faces), (points, np.concatenate([faces[1:], [[0, 1, 4]]])))
    assert model.audit.counts.faces == 4
    assert [tuple(row) for row in model.colors.values[[0, 4]].tolist()] == [DELETED, ADDED]
    assert counts(model) == {"deleted_faces": 1, "added_faces": 1, "cut_edges": 0}
    corners = model.center + model.scale * model.positions("added_faces")[0].astype(np.float64)
    assert np.allclose(corners, points[[0, 1, 4]], atol=1e-6)


def test_a_cut_edge_is_drawn_between_its_vertices_and_can_be_flown_to() -> None:
    points, faces = BOOK
    apart = points[faces.reshape(-1)], np.arange(9).reshape(-1, 3)
    model = model_of(BOOK, apart)
    assert model.layers["cut_edges"].vertices.tolist() == [[0, 1]]
    state = ViewState.first(model)
    assert state.active == "cut_edges"
    state.choose("cut_edges", 0)
    assert state.element == ("cut_edges", 0)


def test_a_repair_that_changes_nothing_has_empty_layers_and_a_page() -> None:
    model = model_of(TETRAHEDRON, TETRAHEDRON)
    state = ViewState.first(model)
    state.next_layer()
    assert state.active in REPAIR_STYLES
    assert b"deleted_faces" in page(model, state, "+y")


def test_what_was_turned_upright_in_a_glb_lies_where_it_was() -> None:
    points, faces = TETRAHEDRON
    before = ViewedMesh("a.triasset", Path("a"), points, faces, up="-y")
    after = ViewedMesh("b.glb", Path("b"), points * [1, -1, -1], faces, up="+y")
    assert not any(counts(build_repaired_model(before, after)).values())
