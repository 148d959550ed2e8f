"""Triangle soups, closed meshes, cameras and target images for the tests of bakes."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.context import SearchContext
from msb.bake.images import ViewImages
from msb.bake.soup_renderer import SoupRenderer
from msb.cl import Device
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.scenes.datasets import Scene, dataset_of, scene_at
from msb.scenes.paths import turntable
from tests.conftest import ROOT

Corners = NDArray[np.float32]
ColoredSoup = tuple[Corners, Corners]
"""The corners (F, 3, 3) of a soup and their colours (F, 3, 3)."""
BACKGROUND = (0.1, 0.2, 0.3)
MODELS = ROOT / "data_stubs" / "models"
SCENE = ROOT / "data_stubs" / "scenes" / "nerf_synthetic" / "pebble"


def ring(count: int, width: int = 48, height: int = 36, z: float = 0.2) -> list[Camera]:
    """Return cameras around the small tetrahedron, all at one height."""
    middle = (0.2, 0.2, z)
    return turntable(middle, 4.0, up=(0, 0, 1), count=count, width=width, height=height, fov_y=0.6)


def cameras(count: int, width: int = 48, height: int = 36) -> list[Camera]:
    """Return cameras on an arc in front of the origin that look at it."""
    angles = np.linspace(-0.6, 0.6, count)
    places = [(4 * np.sin(a), 0.3 * np.cos(3 * a), -4 * np.cos(a)) for a in angles]
    return [Camera.look_at(place, (0, 0, 0), width=width, height=height, fov_y=0.9) for place in places]


def all_round(distance: float, heights: tuple[float, ...], count: int = 8, side: int = 64) -> list[Camera]:
    """Return cameras that look at the origin. They stand on rings around the z axis at several heights."""
    turns = 2 * np.pi * np.arange(count) / count
    places = [
        (distance * np.cos(turn), distance * np.sin(turn), height) for height in heights for turn in turns
    ]
    size: Any = {"width": side, "height": side, "fov_y": 0.9}
    return [Camera.look_at(place, (0, 0, 0), up=(0, 0, 1), **size) for place in places]


def sparse(scene: str, method: str) -> Scene:
    """Return a shipped scene with every third of its views, so that bakes are quicker but rougher."""
    path = ROOT / "data_stubs/scenes" / scene
    whole = scene_at(path, dataset_of(path), method).read()
    return replace(whole, train=whole.train[::3], test=whole.test[::3])


def tiles(side: int = 4, seed: int = 0) -> ColoredSoup:
    """Return a square around the origin. It has 2 x side x side triangles with random colours."""
    random = np.random.default_rng(seed)
    grid = np.linspace(-1, 1, side + 1)
    x, y = (axis.reshape(-1) for axis in np.meshgrid(grid[:-1], grid[:-1]))
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


def images_of(corners: Corners, colors: Corners, views: list[Camera]) -> ViewImages:
    """Return standard-tier images of a soup."""
    asset = asset_from_mesh(mesh_of(corners, colors))

    def draw(camera: Camera) -> NDArray[np.float32]:
        with Renderer(asset, "standard") as renderer:
            return renderer.render(camera, BACKGROUND).image

    return ViewImages(views, BACKGROUND, draw)


@contextmanager
def open_renderer(
    soup: ColoredSoup, target: ColoredSoup, views: list[Camera], device: Device | None = None
) -> Iterator[SoupRenderer]:
    """Yield a renderer of a soup whose target images show another soup."""
    with images_of(*target, views) as images, closing(SoupRenderer(*soup, images, device)) as renderer:
        yield renderer


@contextmanager
def open_context(
    target: ColoredSoup, training: list[Camera], validation: list[Camera] | None = None, **options: Any
) -> Iterator[SearchContext]:
    """Yield a search context whose images show a soup.

    The default validation views are the training views.
    """
    with images_of(*target, training) as images, images_of(*target, validation or training) as others:
        yield SearchContext(images, others, **options)


def ball(rows: int = 16, radius: float = 1.0) -> Mesh:
    """Return a closed ball of 4 * rows * (rows - 1) faces, wound outwards, with colours of `colors_at`."""
    columns = 2 * rows
    up, turn = np.meshgrid(np.pi * np.arange(1, rows) / rows, np.pi * np.arange(columns) / rows)
    grid = np.stack([np.sin(up) * np.cos(turn), np.sin(up) * np.sin(turn), np.cos(up)], axis=-1)
    points = np.concatenate([grid.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    number = np.arange(columns * (rows - 1)).reshape(columns, rows - 1)
    after = np.roll(number, -1, axis=0)
    a, b, c, d = number[:, :-1], number[:, 1:], after[:, 1:], after[:, :-1]
    top, bottom = np.full(columns, len(points) - 2), np.full(columns, len(points) - 1)
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    caps = (top, number[:, 0], after[:, 0]), (bottom, after[:, -1], number[:, -1])
    faces += [np.stack(corners, axis=-1) for corners in caps]
    return Mesh((radius * points).astype(np.float32), np.concatenate(faces), vertex_colors=colors_at(points))


def ball_soup() -> ColoredSoup:
    """Return about 500 faces of the unit ball."""
    soup = soup_of(ball(12))
    return soup.vertices.reshape(-1, 3, 3), soup.vertex_colors.reshape(-1, 3, 3)


def colors_at(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the colours (n, 3) of points (n, 3); they change slowly from place to place."""
    return (0.5 + 0.4 * points).astype(np.float32)


def soup_of(mesh: Mesh) -> Mesh:
    """Return the faces of `mesh` without shared vertices."""
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[mesh.faces].reshape(-1, 3)
    faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), faces, vertex_colors=colors)


def upper_part(mesh: Mesh, z: float) -> Mesh:
    """Return the faces of a mesh whose centre is above z."""
    return Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > z])


def box(sides: tuple[float, float, float], turn: NDArray[np.float64] | None = None) -> Mesh:
    """Return a closed box around the origin, wound outwards, rotated by the matrix `turn`."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * sides
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))], np.int64)
    placed = corners if turn is None else corners @ turn.T
    return Mesh(placed.astype(np.float32), faces)


def torus(rows: int = 12) -> Mesh:
    """Return a closed torus of 4 * rows * rows faces, wound outwards, 2 wide and 0.6 high."""
    columns = 2 * rows
    turn, up = np.meshgrid(
        2 * np.pi * np.arange(columns) / columns, 2 * np.pi * np.arange(rows) / rows, indexing="ij"
    )
    out = 0.7 + 0.3 * np.cos(up)
    points = np.stack([out * np.cos(turn), out * np.sin(turn), 0.3 * np.sin(up)], axis=-1).reshape(-1, 3)
    a = np.arange(columns * rows).reshape(columns, rows)
    b, d = np.roll(a, -1, axis=0), np.roll(a, -1, axis=1)
    c = np.roll(b, -1, axis=1)
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return Mesh(points.astype(np.float32), np.concatenate(faces))


def together(*meshes: Mesh) -> Mesh:
    """Return the faces of several meshes as one mesh without colours."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))
