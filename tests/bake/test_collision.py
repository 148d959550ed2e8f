"""Collision meshes: always something closed, that says what it is and how near it is to what is seen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.bake.apart import distances
from msb.bake.collision import Collision, collision, kind_of, need_libraries
from msb.bake.hulls import smallest_box
from msb.bake.simpler import simpler
from msb.errors import MeshError, UsageError
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from msb.topology.faces import signed_volume
from tests.bake.solids import ball, box, soup_of, together, torus
from tests.bake.soups import all_round, mesh_of, tiles

TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def checked(made: Collision) -> Collision:
    """Return what was made, once it is closed, wound outwards and float32."""
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"
    assert signed_volume(made.mesh.vertices, made.mesh.faces) > 0
    assert made.mesh.vertices.dtype == np.float32
    assert made.mean_distance >= 0
    assert 0 <= made.mid_air_share <= 1
    return made


def solids(made: Collision) -> list[NDArray[np.float64]]:
    """Return the planes (n, 4) of each convex part, outwards."""
    points, faces = made.mesh.vertices.astype(np.float64), made.mesh.faces
    ends = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    label = label_components(len(points), *ends)[1][faces[:, 0]]
    found = []
    for number in np.unique(label):
        corners = points[faces[label == number]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        found.append(np.column_stack([normal, -(normal * corners[:, 0]).sum(axis=1)]))
    return found


def test_a_box_is_found_as_it_is_turned() -> None:
    made = checked(collision(box((1, 2, 3), TURN), "box"))
    assert (made.kind, made.parts, len(made.mesh.faces), made.why) == ("box", 1, 12, "")
    assert signed_volume(made.mesh.vertices, made.mesh.faces) == pytest.approx(6, rel=1e-3)
    assert made.mean_distance < 1e-4
    assert made.mid_air_share == 0


def test_boxes_look_outwards_however_they_are_turned() -> None:
    """Of what has no hull the box lies along the principal axes, which may be mirrored."""
    for seed in range(8):
        corners = np.random.default_rng(seed).normal(size=(3, 3))
        assert signed_volume(*smallest_box(corners)) > 0


def test_no_place_is_at_no_distance() -> None:
    whole = ball(4)
    assert distances(np.zeros((0, 3)), whole.vertices.astype(np.float64), whole.faces).shape == (0,)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:100", "hulls:4"])
def test_a_room_of_few_large_faces_has_a_shape(kind: str) -> None:
    """All of its corners are so far off that they are taken for the sky."""
    room = box((60, 60, 60))
    inside = Mesh(room.vertices, room.faces[:, ::-1].copy())
    made = collision(inside, kind, all_round(2, (-0.5, 0.5)))
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"


def test_a_closed_surface_gets_fewer_faces() -> None:
    made = checked(collision(ball(), "mesh:200"))
    assert (made.kind, made.parts, made.why) == ("mesh", 1, "")
    assert 100 < len(made.mesh.faces) <= 200
    assert made.mean_distance < 0.01
    assert made.mid_air_share < 0.05


def test_a_surface_that_so_few_faces_would_tear_down_keeps_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """As decimation does to sides of flat boxes, whose slim faces it cannot spare."""
    torn = ball(6, 0.05)

    def stuck(points: NDArray[Any], faces: NDArray[Any], count: int) -> tuple[NDArray[Any], NDArray[Any]]:
        return (torn.vertices, torn.faces) if count < len(torn.faces) else simpler(points, faces, count)

    monkeypatch.setattr("msb.bake.collision.simpler", stuck)
    made = checked(collision(ball(), "mesh:50"))
    assert len(torn.faces) < len(made.mesh.faces) <= 200
    assert made.mean_distance < 0.01


def test_a_surface_whose_vertices_are_only_doubled_is_closed() -> None:
    assert collision(soup_of(ball()), "mesh:200").kind == "mesh"


@pytest.mark.slow
def test_an_open_mesh_gets_hulls_that_cover_it_and_says_why() -> None:
    whole = soup_of(ball())
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.7]
    made = checked(collision(Mesh(whole.vertices, faces), "mesh:1000"))
    assert (made.kind, made.why) == ("hulls", "the mesh is not closed")
    assert 8 < made.parts <= 31
    assert len(made.mesh.faces) < 2000
    assert made.mean_distance < 0.02
    assert made.mid_air_share < 0.4  # the hulls' inner sides
    points = whole.vertices[faces].mean(axis=1)
    planes = solids(made)
    assert len(planes) == made.parts
    out = np.min([(points @ each[:, :3].T + each[:, 3]).max(axis=1) for each in planes], axis=0)
    assert out.max() < 0.07


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_what_cameras_see_of_a_soup_is_enclosed(size: float) -> None:
    whole = soup_of(ball())
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.9]
    soup = Mesh(whole.vertices * np.float32(size), faces)
    views = [replace(camera, unit=size) for camera in all_round(3 * size, (-size, size))]
    made = checked(collision(soup, "mesh:500", views))
    assert (made.kind, made.parts, made.why) == ("mesh", 1, "")
    assert 400 < len(made.mesh.faces) <= 520
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.05


@pytest.mark.slow
def test_the_bottom_of_a_plate_that_nobody_sees_is_near_it() -> None:
    plate = box((2, 2, 0.07))
    faces = plate.faces[plate.vertices[plate.faces].mean(axis=1)[:, 2] > -0.03]
    made = checked(collision(soup_of(Mesh(plate.vertices, faces)), "mesh:200", all_round(3, (1, 2))))
    assert made.kind == "mesh"
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.05


@pytest.mark.slow
def test_of_a_scene_a_sheet_lies_behind_what_is_seen() -> None:
    """A bump on a large floor, seen from above it."""
    corners, _ = tiles(12)
    floor = 20 * corners.reshape(-1, 3)
    rises = np.exp(-np.square(floor[:, :2]).sum(axis=1, keepdims=True))
    floor[:, 2:] = rises.astype(np.float32)
    made = checked(collision(mesh_of(floor.reshape(-1, 3, 3), corners), "mesh:400", all_round(4, (2, 3))))
    assert (made.kind, made.why) == ("mesh", "")
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.1
    assert np.abs(made.mesh.vertices).max() < 25  # no sky
    hulls = checked(collision(mesh_of(floor.reshape(-1, 3, 3), corners), "hulls:8", all_round(4, (2, 3))))
    assert hulls.kind == "hulls"
    assert "scene" in hulls.why


@pytest.mark.slow
def test_what_encloses_nothing_gets_hulls_and_says_why() -> None:
    """A face that cameras see from both sides, and one that none sees."""
    face = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    away = Mesh(face.vertices + np.float32([0, 0, 99]), face.faces)
    for mesh, why in ((face, "encloses nothing"), (away, "not closed")):
        made = checked(collision(mesh, "mesh:100", all_round(3, (-1, 1))))
        assert made.kind == "hulls"
        assert why in made.why
        assert made.mean_distance < 0.01


@pytest.mark.slow
def test_more_hulls_leave_less_in_mid_air() -> None:
    apart = Mesh(ball(8).vertices + np.float32([9, 0, 0]), ball(8).faces)
    two = together(ball(8), Mesh(apart.vertices, apart.faces[1:]))
    one, both = (checked(collision(two, f"hulls:{count}")) for count in (1, 2))
    assert (one.parts, both.parts) == (1, 2)
    assert one.mid_air_share > 0.5 > 0.05 > both.mid_air_share


@pytest.mark.slow
def test_without_the_time_for_a_solid_hulls_are_of_its_surface() -> None:
    made = checked(collision(ball(), "hulls:8", seconds=1e-3))
    assert made.kind == "hulls"
    assert made.parts == 8
    assert "did not end within 0.001 s" in made.why


@pytest.mark.slow
def test_a_solid_is_cut_into_convex_parts() -> None:
    pytest.importorskip("coacd", reason="extra trial is not installed")
    made = checked(collision(torus(), "hulls:16", seconds=300))
    assert (made.kind, made.why) == ("hulls", "")
    assert 4 <= made.parts <= 16
    assert made.mean_distance < 0.02
    assert made.mid_air_share < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("kind", ["mesh:100", "hulls:4", "box"])
def test_a_single_face_of_any_size_has_a_shape(size: float, kind: str) -> None:
    face = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0.3, 0.2, 0.9]]) * np.float32(size), np.array([[0, 1, 2]]))
    made = checked(collision(face, kind))
    assert made.mean_distance < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:100", "hulls:4", "box"])
def test_what_is_flat_has_a_shape_of_little_thickness(kind: str) -> None:
    corners, colors = tiles(3)
    made = checked(collision(mesh_of(np.float32(1e-6) * corners, colors), kind))
    assert made.mean_distance < 0.002
    assert made.mid_air_share == 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:100", "box"])
def test_vertices_of_no_face_do_not_count(kind: str) -> None:
    whole = ball(8)
    lost = np.float32([[np.nan, 0, 0], [9, 9, 9]])
    made = checked(collision(Mesh(np.concatenate([whole.vertices, lost]), whole.faces), kind))
    assert np.abs(made.mesh.vertices).max() < 2


@pytest.mark.parametrize("kind", ["hulls:4", "box"])
def test_faces_in_one_place_have_a_shape(kind: str) -> None:
    checked(collision(Mesh(np.ones((3, 3), np.float32), np.array([[0, 1, 2]])), kind))


def test_what_cannot_be_is_said_in_a_line() -> None:
    with pytest.raises(MeshError, match="without faces"):
        collision(Mesh(np.ones((3, 3), np.float32), np.zeros((0, 3), np.int64)), "box")
    with pytest.raises(MeshError, match="not finite"):
        collision(Mesh(np.full((3, 3), np.nan, np.float32), np.array([[0, 1, 2]])), "box")


def test_what_encloses_is_asked_for_first_only_where_no_repair_closes_a_mesh(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "skimage")
    cube = box((1, 1, 1))
    turned = cube.faces.copy()
    turned[0] = turned[0, ::-1]
    beside = together(cube, replace(cube, vertices=cube.vertices + np.float32([1, 1, 0])))
    for vertices, faces in ((cube.vertices, turned), (beside.vertices, beside.faces)):
        need_libraries("mesh:12", (vertices, faces))
    with pytest.raises(UsageError, match="what encloses an open mesh needs"):
        need_libraries("mesh:12", (cube.vertices, cube.faces[1:]))


def test_kinds_are_read() -> None:
    assert [kind_of(text) for text in ("mesh:1000", "hulls:16", "box")] == [
        ("mesh", 1000),
        ("hulls", 16),
        ("box", 1),
    ]


@pytest.mark.parametrize(
    "text", ["", "mesh", "mesh:", "mesh:3", "hulls:0", "hulls:x", "box:2", "ball", "mesh:1e3"]
)
def test_what_is_no_kind_is_said_in_a_line(text: str) -> None:
    with pytest.raises(UsageError, match=r"mesh:N .*, hulls:N .* or box") as caught:
        kind_of(text)
    assert "\n" not in str(caught.value)
