"""The data of a view: layers and counts of the audit, first view, components, notes."""

from pathlib import Path

import numpy as np
import pytest

from msb.topology import audit_arrays
from msb_viewers.model import CLEAN_NOTE, EMPTY_NOTE, SOUP_NOTE, ViewModel, build_model
from msb_viewers.page import page
from msb_viewers.palette import ADDED, DELETED, REPAIR_STYLES, STYLES
from msb_viewers.repaired import build_repaired_model
from msb_viewers.stage import simplify
from msb_viewers.state import ViewState
from msb_viewers.viewed_mesh import Colors, ViewedMesh, merge_seams, read_viewed_mesh
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.seamed import CUBE, CUBE_UVS, doubled
from tests.viewers.conftest import model_of


def test_layers_count_what_the_audit_counts(demo: ViewModel) -> None:
    counts = demo.audit.counts
    for kind, layer in demo.layers.items():
        if kind == "degenerate_faces":
            assert len(layer) == counts.repeated_index_faces + counts.zero_area_faces
        elif kind == "seam_edges":
            assert not len(layer)
        else:
            assert len(layer) == getattr(counts, kind), kind
    assert len(demo.sizes) == counts.components
    assert demo.sizes[0] == counts.largest_component_faces
    assert sum(group.components for group in demo.size_classes()) == counts.components - 1


def test_each_defect_is_in_its_layer(faults: ViewModel) -> None:
    vertices_of = {kind: sorted(layer.vertices.reshape(-1).tolist()) for kind, layer in faults.layers.items()}
    assert vertices_of["nonmanifold_edges"] == [5, 6]
    assert vertices_of["multifan_vertices"] == [2]
    assert vertices_of["nonmanifold_edge_endpoints"] == [5, 6]
    assert vertices_of["duplicate_faces"] == [10, 11, 12]
    assert vertices_of["degenerate_faces"] == [13, 14, 14]
    # Vertices that are only used by a face that lists a vertex twice count as unused.
    assert vertices_of["unreferenced_vertices"] == [13, 14, 15]


def test_positions_are_transformed_to_view_units() -> None:
    far = np.array([1e7, -2e7, 5e6])
    model = model_of(TETRAHEDRON[0].astype(np.float64) * 0.01 + far, TETRAHEDRON[1])
    assert np.linalg.norm(model.points, axis=1).max() == pytest.approx(1, abs=1e-6)
    back = model.center + model.scale * model.points.astype(np.float64)
    assert np.abs(back - model.analysis.vertices).max() < 1e-8


def test_a_few_distant_vertices_do_not_shrink_the_first_view() -> None:
    random = np.random.default_rng(0)
    points = random.normal(size=(300, 3))
    points[:3] *= 1e6
    model = model_of(points, np.arange(300).reshape(-1, 3))
    assert np.quantile(np.linalg.norm(model.points, axis=1), 0.9) > 0.3
    assert any("distant vertices" in note for note in model.notes)


def test_faces_that_are_not_finite_are_not_drawn() -> None:
    points = TETRAHEDRON[0].astype(np.float64)
    points[3, 1] = np.nan
    model = model_of(points, TETRAHEDRON[1])
    assert model.drawn.tolist() == [True, False, False, False]
    assert np.isfinite(model.points).all()


def test_positions_beyond_float32_are_not_drawn() -> None:
    points = np.concatenate([np.random.default_rng(0).normal(size=(300, 3)), [[1e200, 0, 0], [0, 1, 0]]])
    faces = np.concatenate([np.arange(300).reshape(-1, 3), [[0, 300, 301]]])
    model = model_of(points, faces)
    assert model.drawn.tolist() == 100 * [True] + [False]
    assert model.finite(faces).tolist() == model.drawn.tolist()


@pytest.mark.parametrize("scale", [1e300, 1e-300, 0.0])
def test_any_size_gives_finite_positions(scale: float) -> None:
    model = model_of(TETRAHEDRON[0].astype(np.float64) * scale, TETRAHEDRON[1])
    assert np.isfinite(model.points).all()
    assert model.drawn.all()


def test_notes_describe_clean_empty_and_soup_meshes() -> None:
    assert CLEAN_NOTE in model_of(*TETRAHEDRON).notes
    assert CLEAN_NOTE not in model_of(*BOOK).notes
    assert EMPTY_NOTE in model_of(np.zeros((2, 3)), []).notes
    soup = model_of(np.random.default_rng(0).normal(size=(9, 3)), np.arange(9).reshape(3, 3))
    assert SOUP_NOTE in soup.notes
    assert "boundary_edges" not in soup.default_layers()


def test_seams_are_a_layer_that_is_off_at_first_and_no_defect() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)
    colors = Colors(np.arange(3 * len(points), dtype=np.uint8).reshape(-1, 3), "vertex")
    mesh = ViewedMesh("a.ply", None, points, faces, colors, attributes={"uv": uvs})
    audit, stored = audit_arrays(points, faces, attributes=mesh.attributes)
    merged, analysis = merge_seams(mesh)
    model = build_model(merged, audit, analysis, stored)
    state = ViewState.first(model)
    assert audit.without_seams is not None
    assert {kind: len(layer) for kind, layer in model.layers.items() if len(layer)} == {"seam_edges": 12}
    assert len(model.sizes) == audit.without_seams.counts.components == 1
    assert "seam_edges" not in state.visible
    assert model.colors is not None
    assert np.array_equal(model.colors.values, colors.values[faces.reshape(-1)])
    assert model.seams is not None
    # Vertices have the numbers of the file, and every row of the file selects its vertex.
    assert [model.row_in_file(vertex) for vertex in range(8)] == sorted(set(model.seams.first.tolist()))
    assert {model.vertex_of_row(row) for row in range(len(points))} == set(range(8))
    assert model.vertex_of_row(len(points)) is None
    assert b"stored_rows" in page(model, state, "+y")


def test_no_two_layers_differ_by_colour_alone() -> None:
    looks = [
        (style.of, style.line, style.marker, style.width > 3 if style.of == "edge" else None)
        for style in STYLES.values()
    ]
    assert len(set(looks)) == len(looks)


def test_colours_of_an_asset_are_those_of_the_standard_tier(demo_asset: Path) -> None:
    import msb
    from msb.meshes.assets import mesh_from_asset

    mesh = read_viewed_mesh(demo_asset)
    wanted = mesh_from_asset(msb.load(demo_asset)).vertex_colors
    assert mesh.colors.domain == "vertex"
    assert np.abs(mesh.colors.values / 255 - wanted).max() <= 0.5 / 255 + 1e-6


def test_a_simplified_mesh_has_the_target_size_and_the_same_position(demo: ViewModel) -> None:
    faces, origin = simplify(demo.points, demo.faces, target=2000)
    assert 500 < len(faces) <= 4000
    assert (np.diff(np.sort(faces, axis=1), axis=1) > 0).all()
    assert (np.diff(origin) > 0).all()
    moved = np.linalg.norm(demo.points[faces] - demo.points[demo.faces[origin]], axis=2)
    assert moved.max() < 0.2


def repaired(before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]) -> ViewModel:
    meshes = (ViewedMesh(f"{name}.ply", Path(name), *mesh) for name, mesh in (("a", before), ("b", after)))
    return build_repaired_model(*meshes)


def counts(model: ViewModel) -> dict[str, int]:
    return {kind: len(layer) for kind, layer in model.layers.items()}


def test_deleted_and_added_faces_are_layers_with_colours() -> None:
    points, faces = TETRAHEDRON
    points = np.concatenate([points, [[2, 2, 2]]]).astype(np.float32)
    model = repaired((points, faces), (points, np.concatenate([faces[1:], [[0, 1, 4]]])))
    assert model.audit.counts.faces == 4
    assert [tuple(row) for row in model.colors.values[[0, 4]].tolist()] == [DELETED, ADDED]
    assert counts(model) == {"deleted_faces": 1, "added_faces": 1, "cut_edges": 0}
    corners = model.center + model.scale * model.positions("added_faces")[0].astype(np.float64)
    assert np.allclose(corners, points[[0, 1, 4]], atol=1e-6)


def test_a_cut_edge_is_a_layer_and_can_be_selected() -> None:
    points, faces = BOOK
    apart = points[faces.reshape(-1)], np.arange(9).reshape(-1, 3)
    model = repaired(BOOK, apart)
    assert model.layers["cut_edges"].vertices.tolist() == [[0, 1]]
    state = ViewState.first(model)
    assert state.active == "cut_edges"
    state.choose("cut_edges", 0)
    assert state.element == ("cut_edges", 0)


def test_a_repair_that_changes_nothing_has_empty_layers_and_a_page() -> None:
    model = repaired(TETRAHEDRON, TETRAHEDRON)
    state = ViewState.first(model)
    state.next_layer()
    assert state.active in REPAIR_STYLES
    assert b"deleted_faces" in page(model, state, "+y")


def test_a_repaired_glb_is_rotated_back() -> None:
    points, faces = TETRAHEDRON
    before = ViewedMesh("a.triasset", Path("a"), points, faces, up="-y")
    after = ViewedMesh("b.glb", Path("b"), points * [1, -1, -1], faces, up="+y")
    assert not any(counts(build_repaired_model(before, after)).values())
