"""Scenes to compare: a texture seen close and far away, and vertex colours like those of a trained mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_stubs.make import splat_like_asset
from msb import Camera
from msb.asset import Description, build_asset
from msb.asset.manifest import CoordinateFrame
from msb.asset.texture import Sampler

if TYPE_CHECKING:
    from msb.asset import Asset

SIDE = 512
"""Side of the texture in texels."""
WIDTH, HEIGHT = 960, 720
NEAR, FAR = 0.1, 100.0
"""Near and far planes around the scene, for engines that need them."""


class Scene(NamedTuple):
    """An asset and its view: eye, target and vertical field of view in degrees. +y is up."""

    asset: Asset
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    degrees: float

    @property
    def camera(self) -> Camera:
        """The view as a camera of our renderers."""
        angle = float(np.radians(self.degrees))
        return Camera.look_at(self.eye, self.target, up=(0, 1, 0), width=WIDTH, height=HEIGHT, fov_y=angle)

    @property
    def view(self) -> dict[str, Any]:
        """The view as JSON for the engines."""
        return {"eye": self.eye, "target": self.target, "degrees": self.degrees, "near": NEAR, "far": FAR}


def painting() -> NDArray[np.uint8]:
    """Return the texture. It has discs, and coarse and fine waves, with all tones from black to white."""
    y, x = (np.mgrid[0:SIDE, 0:SIDE] + 0.5) / SIDE
    turn = 2 * np.pi
    long = [np.sin(turn * (x + np.sin(turn * y) / 4)), np.sin(turn * (y - x)), np.cos(turn * 2 * y)]
    fine = np.sin(turn * 20 * x) * np.sin(turn * 16 * y)
    image = 0.5 + 0.46 * np.stack(long, axis=-1) + 0.04 * fine[..., None]
    for number in range(12):
        at = (number * 0.381966) % 1, (number * 0.7548777) % 1
        distance = np.hypot((x - at[0] + 0.5) % 1 - 0.5, (y - at[1] + 0.5) % 1 - 0.5)
        edge = np.clip((0.04 - distance) * SIDE / 8, 0, 1)[..., None]  # eight texels wide
        image = image * (1 - edge) + edge * (number % 4 == np.arange(3))
    return np.asarray(np.round(255 * np.clip(image, 0, 1)), np.uint8)


def ball() -> Asset:
    """Return a ball wrapped in the texture, seen so close that every texel covers several pixels."""
    u, v, faces = _grid(48, 24)
    around, down = 2 * np.pi * u, np.pi * v
    points = [np.sin(down) * np.sin(around), np.cos(down), np.sin(down) * np.cos(around)]
    return _textured(np.stack(points, axis=1), faces, np.stack([u, v], axis=1))


def floor() -> Asset:
    """Return a floor with a repeated texture. In the distance a pixel covers many texels."""
    u, v, faces = _grid(16, 16)
    points = [20 * u - 10, np.zeros(len(u)), 20 * v - 16]
    return _textured(np.stack(points, axis=1), faces, 12 * np.stack([u, v], axis=1))


def _textured(points: NDArray[np.float64], faces: NDArray[np.int64], uv: NDArray[np.float64]) -> Asset:
    buffers = {
        "positions": points.astype(np.float32),
        "indices": faces.astype(np.uint32),
        "uv": uv.astype(np.float32),
        "texture.0": painting(),
    }
    domains = {"uv": "vertex", "texture.0": "global"}
    frame = CoordinateFrame(up="+y")
    return build_asset(buffers, domains, Description(appearance=Sampler().appearance, coordinate_frame=frame))


def _grid(columns: int, rows: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the two coordinates of grid points over the unit square, and the triangles between them."""
    v, u = (axis.ravel() for axis in np.mgrid[0 : rows + 1, 0 : columns + 1])
    corner = np.flatnonzero((u < columns) & (v < rows))
    below = corner + columns + 1
    faces = np.concatenate(
        [np.stack(f, axis=1) for f in ((corner, below, corner + 1), (corner + 1, below, below + 1))]
    )
    return u / columns, v / rows, faces


SCENES: dict[str, tuple[str, Callable[[], Scene]]] = {
    "texture": (
        "a ball whose texels cover pixels",
        lambda: Scene(ball(), (0.6, 0.8, 2.6), (0.0, 0.0, 0.0), 42.0),
    ),
    "mipmaps": (
        "a floor whose pixels cover texels",
        lambda: Scene(floor(), (0.0, 1.5, 4.0), (0.0, 0.0, -1.5), 45.0),
    ),
    "colours": (
        "a mesh of 35 thousand faces with vertex colours, like MeshSplatting's",
        lambda: Scene(splat_like_asset(), (1.3, 0.8, 2.6), (0.5, 0.5, 0.5), 25.0),
    ),
}
