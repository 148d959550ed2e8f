"""Soups and lessons for the tests of a bake."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.bake.lessons import Lessons
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.scenes.datasets import Scene, dataset_of, scene_at
from tests.conftest import ROOT

Corners = NDArray[np.float32]
BACKGROUND = (0.1, 0.2, 0.3)


def cameras(count: int, width: int = 48, height: int = 36) -> list[Camera]:
    """Return cameras in an arc before the origin, which look at it."""
    angles = np.linspace(-0.6, 0.6, count)
    return [
        Camera.look_at(
            (4 * np.sin(a), 0.3 * np.cos(3 * a), -4 * np.cos(a)),
            (0, 0, 0),
            width=width,
            height=height,
            fov_y=0.9,
        )
        for a in angles
    ]


def all_round(away: float, heights: tuple[float, ...], count: int = 8, side: int = 64) -> list[Camera]:
    """Return cameras in rings about the z axis, at some heights, which look at the origin."""
    return [
        Camera.look_at(
            (away * np.cos(turn), away * np.sin(turn), height),
            (0, 0, 0),
            up=(0, 0, 1),
            width=side,
            height=side,
            fov_y=0.9,
        )
        for height in heights
        for turn in 2 * np.pi * np.arange(count) / count
    ]


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
