"""Soups, solids and lessons for the tests of a bake."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.lessons import Lessons
from msb.bake.raster import Raster
from msb.bake.start import Guide
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.scenes.datasets import Scene, dataset_of, scene_at
from msb.scenes.paths import turntable
from tests.conftest import ROOT

Corners = NDArray[np.float32]
BACKGROUND = (0.1, 0.2, 0.3)
MODELS = ROOT / "data_stubs" / "models"
SCENE = ROOT / "data_stubs" / "scenes" / "nerf_synthetic" / "pebble"


def ring(count: int, width: int = 48, height: int = 36, z: float = 0.2) -> list[Camera]:
    """Return cameras around the small tetrahedron, all at one height."""
    middle = (0.2, 0.2, z)
    return turntable(middle, 4.0, up=(0, 0, 1), count=count, width=width, height=height, fov_y=0.6)


def cameras(count: int, width: int = 48, height: int = 36) -> list[Camera]:
    """Return cameras in an arc before the origin, which look at it."""
    angles = np.linspace(-0.6, 0.6, count)
    places = [(4 * np.sin(a), 0.3 * np.cos(3 * a), -4 * np.cos(a)) for a in angles]
    return [Camera.look_at(place, (0, 0, 0), width=width, height=height, fov_y=0.9) for place in places]


def all_round(away: float, heights: tuple[float, ...], count: int = 8, side: int = 64) -> list[Camera]:
    """Return cameras in rings about the z axis, at some heights, which look at the origin."""
    turns = 2 * np.pi * np.arange(count) / count
    places = [(away * np.cos(turn), away * np.sin(turn), height) for height in heights for turn in turns]
    size: Any = {"width": side, "height": side, "fov_y": 0.9}
    return [Camera.look_at(place, (0, 0, 0), up=(0, 0, 1), **size) for place in places]


def sparse(scene: str, method: str) -> Scene:
    """Return a shipped scene with every third of its views: what is made of them is rougher, and sooner."""
    path = ROOT / "data_stubs/scenes" / scene
    whole = scene_at(path, dataset_of(path), method).read()
    return replace(whole, train=whole.train[::3], test=whole.test[::3])


def tiles(side: int = 4, seed: int = 0) -> tuple[Corners, Corners]:
    """Return corners and colours of a square of 2 x side x side triangles about the origin."""
    random = np.random.default_rng(seed)
    grid = np.linspace(-1, 1, side + 1)
    x, y = (each.reshape(-1) for each in np.meshgrid(grid[:-1], grid[:-1]))
    step = 2 / side
    a, b, c, d = (
        np.stack([x + i * step, y + j * step, np.zeros_like(x)], axis=1) for j in (0, 1) for i in (0, 1)
    )
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    colors = random.uniform(0.1, 0.9, size=corners.shape)
    return corners.astype(np.float32), colors.astype(np.float32)


def mesh_of(corners: Corners, colors: Corners) -> Mesh:
    faces = np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, vertex_colors=colors.reshape(-1, 3))


def lessons_of(corners: Corners, colors: Corners, seen_by: list[Camera]) -> Lessons:
    """Return lessons that show this soup on the standard tier."""
    asset = asset_from_mesh(mesh_of(corners, colors))

    def draw(camera: Camera) -> NDArray[np.float32]:
        with Renderer(asset, "standard") as renderer:
            return renderer.render(camera, BACKGROUND).image

    return Lessons(seen_by, BACKGROUND, draw)


Colored = tuple[Corners, Corners]


@contextmanager
def taught(
    soup: Colored, shown: Colored, seen_by: list[Camera], device: Device | None = None
) -> Iterator[Raster]:
    """Give a raster of corners and colours that pictures of others teach."""
    with lessons_of(*shown, seen_by) as lessons, closing(Raster(*soup, lessons, device)) as raster:
        yield raster


@contextmanager
def guide_of(
    shown: Colored, seen_by: list[Camera], aside: list[Camera] | None = None, **options: Any
) -> Iterator[Guide]:
    """Give a guide by pictures of corners and colours; they are judged by the cameras `aside`, else by the
    same ones."""
    with lessons_of(*shown, seen_by) as lessons, lessons_of(*shown, aside or seen_by) as others:
        yield Guide(lessons, others, **options)


def ball(rows: int = 16, radius: float = 1.0) -> Mesh:
    """Return a closed ball of 4 rows (rows - 1) faces, wound outwards, coloured by its places."""
    columns = 2 * rows
    up, round_ = np.meshgrid(np.pi * np.arange(1, rows) / rows, np.pi * np.arange(columns) / rows)
    ring = np.stack([np.sin(up) * np.cos(round_), np.sin(up) * np.sin(round_), np.cos(up)], axis=-1)
    points = np.concatenate([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    number = np.arange(columns * (rows - 1)).reshape(columns, rows - 1)
    after = np.roll(number, -1, axis=0)
    a, b, c, d = number[:, :-1], number[:, 1:], after[:, 1:], after[:, :-1]
    top, bottom = np.full(columns, len(points) - 2), np.full(columns, len(points) - 1)
    faces = [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    caps = (top, number[:, 0], after[:, 0]), (bottom, after[:, -1], number[:, -1])
    faces += [np.stack(each, axis=-1) for each in caps]
    return Mesh((radius * points).astype(np.float32), np.concatenate(faces), vertex_colors=colors_at(points))


def colors_at(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return colours that change slowly from place to place."""
    return (0.5 + 0.4 * points).astype(np.float32)


def soup_of(mesh: Mesh) -> Mesh:
    """Return the faces of `mesh` with vertices of their own."""
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[mesh.faces].reshape(-1, 3)
    faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), faces, vertex_colors=colors)


def box(sides: tuple[float, float, float], turn: NDArray[np.float64] | None = None) -> Mesh:
    """Return a closed box about the origin, wound outwards, turned by the matrix `turn`."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * sides
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))], np.int64)
    placed = corners if turn is None else corners @ turn.T
    return Mesh(placed.astype(np.float32), faces)


def torus(rows: int = 12) -> Mesh:
    """Return a closed ring of 4 rows x rows faces, wound outwards, that is 2 wide and 0.6 high."""
    columns = 2 * rows
    round_, up = np.meshgrid(
        2 * np.pi * np.arange(columns) / columns, 2 * np.pi * np.arange(rows) / rows, indexing="ij"
    )
    out = 0.7 + 0.3 * np.cos(up)
    points = np.stack([out * np.cos(round_), out * np.sin(round_), 0.3 * np.sin(up)], axis=-1).reshape(-1, 3)
    a = np.arange(columns * rows).reshape(columns, rows)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    faces = [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    return Mesh(points.astype(np.float32), np.concatenate(faces))


def together(*meshes: Mesh) -> Mesh:
    """Return the faces of several meshes, without colours."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
