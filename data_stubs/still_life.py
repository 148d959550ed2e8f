"""Content of the stub scenes: painted pebbles on a mosaic, alone and in front of a wall.

Shapes are signed distance functions, z up. They give the surface (by marching cubes), normals, ambient
occlusion and soft shadows. Vertices are closer together than pixels, so vertex colours serve as a texture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.measure import marching_cubes

if TYPE_CHECKING:
    Reals = NDArray[np.float64]
    Paint = Callable[[Reals], tuple[Reals, Reals]]

STEP = 0.016
"""Side of a marching cube, about as large as a pixel of the stub photographs."""
BOX = np.array([[-1.1, -1.05, -0.76], [1.1, 0.85, 0.95]])
"""Bounding box of the pebbles."""
GROUND = -0.72
"""Height of the mosaic."""
TABLE_RADIUS = 1.35
ROOM_RADIUS = 9.0
SUN = np.array([0.45, -0.55, 0.70]) / np.linalg.norm([0.45, -0.55, 0.70])
SUN_WIDTH = 0.12
"""Tangent of the light's angular radius; larger values give softer shadows."""
SKY = 0.42
"""Ambient light of an unoccluded point."""
SHEEN_POWER = 10.0

STONE = 0.42
"""Length of a stone of the mosaic along its radius."""

CREAM, SLATE, COBALT, RUST, OCHRE, MOSS = (
    np.array(color)
    for color in (
        (0.86, 0.81, 0.70),
        (0.24, 0.26, 0.30),
        (0.16, 0.28, 0.56),
        (0.68, 0.31, 0.19),
        (0.85, 0.65, 0.20),
        (0.36, 0.46, 0.28),
    )
)
STONES = np.array([[0.62, 0.55, 0.46], [0.36, 0.44, 0.42], [0.55, 0.34, 0.28]])
SKY_COLORS = np.array([[0.74, 0.70, 0.62], [0.38, 0.52, 0.66]])


@dataclass(frozen=True)
class LitSurface:
    """A triangle mesh with lit vertices.

    Attributes
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64
    color : (V, 3) float64
        View-independent colour in [0, 1].
    normal : (V, 3) float64
        Unit vectors.
    sheen : (V,) float64
        Strength of the highlight, added to every channel.
    sun : (3,) float64
        Direction to the sun, a unit vector.
    """

    vertices: Reals
    faces: NDArray[np.int64]
    color: Reals
    normal: Reals
    sheen: Reals
    sun: Reals

    def seen_from(self, center: ArrayLike) -> Reals:
        """Return the colours (V, 3) for a camera at `center`, with a Blinn-Phong highlight.

        J. Blinn, "Models of light reflection for computer synthesized pictures" (1977).
        """
        to_camera = np.asarray(center, np.float64) - self.vertices
        half = to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True) + self.sun
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        mirrored = np.clip(np.einsum("ij,ij->i", half, self.normal), 0, 1) ** SHEEN_POWER
        return np.clip(self.color + (self.sheen * mirrored)[:, None], 0, 1)

    def turned(self, rotation: Reals) -> LitSurface:
        """Return the surface and its light rotated about the origin."""
        return LitSurface(
            self.vertices @ rotation.T,
            self.faces,
            self.color,
            self.normal @ rotation.T,
            self.sheen,
            rotation @ self.sun,
        )


@dataclass(frozen=True)
class Stone:
    """A pebble: a slightly uneven ellipsoid, rotated about z and then about x, or a ring.

    `look` names its paint: base and pattern.
    """

    center: tuple[float, float, float]
    radii: tuple[float, float, float]
    turn: float
    tip: float
    paint: tuple[NDArray[np.float64], NDArray[np.float64]]
    waves: int
    hole: bool = False

    def local(self, points: Reals) -> Reals:
        """Return points (n, 3) in the axes of the ellipsoid."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        d, t = np.cos(self.tip), np.sin(self.tip)
        axes = np.array([[c, -s * d, s * t], [s, c * d, -c * t], [0, t, d]])
        return np.asarray((points - self.center) @ axes)

    def distance(self, points: Reals) -> Reals:
        """Return signed distances (n,), negative inside.

        Near the stone they are accurate to a few per cent.
        """
        local = self.local(points)
        if self.hole:
            around = np.hypot(local[:, 0], local[:, 1]) - self.radii[0]
            return np.asarray(np.hypot(around, local[:, 2]) - self.radii[2])
        x, y, z = (7 * local).T
        return _ellipsoid(local, self.radii) + 0.012 * np.sin(x + self.turn) * np.sin(y) * np.sin(z + 1)

    def painted(self, points: Reals) -> tuple[Reals, Reals]:
        """Return the colours (n, 3) and the sheen (n,) of points on the stone.

        A wave goes around the middle, with dots above and below the wave.
        """
        base, pattern = self.paint
        local = self.local(points) / self.radii
        turn, height = np.arctan2(local[:, 1], local[:, 0]), local[:, 2]
        wave = 0.16 - np.abs(height - 0.16 * np.sin(self.waves * turn))
        place = (turn * self.waves / np.pi) % 2 - 1
        dots = 0.13 - np.minimum(
            *(np.hypot(0.9 * place / self.waves * np.pi, height - level) for level in (-0.45, 0.52))
        )
        share = _step(wave, 0.06) if self.hole else np.maximum(_step(wave, 0.06), _step(dots, 0.06))
        return base + share[:, None] * (pattern - base), np.full(len(points), 0.42)


STONE_HEIGHTS = GROUND + np.array([0.33, 0.86, 1.26])
PEBBLES = (
    Stone((0.0, 0.0, STONE_HEIGHTS[0]), (0.82, 0.66, 0.34), 0.3, 0.0, (SLATE, CREAM), 9),
    Stone((0.05, -0.02, STONE_HEIGHTS[1]), (0.52, 0.46, 0.24), 1.1, 0.07, (RUST, CREAM), 7),
    Stone((-0.02, 0.03, STONE_HEIGHTS[2]), (0.33, 0.30, 0.19), 2.0, -0.08, (COBALT, OCHRE), 5),
    Stone((0.66, -0.66, GROUND + 0.15), (0.27, 0.19, 0.16), 0.7, 0.0, (OCHRE, RUST), 5),
    Stone((-0.62, -0.68, GROUND + 0.19), (0.19, 0.19, 0.085), -0.5, 0.75, (MOSS, CREAM), 6, hole=True),
)
"""A pile of three pebbles, a small pebble, and a pebble with a hole that leans against the pile."""


@lru_cache(maxsize=1)
def pebbles() -> LitSurface:
    """Return the pebbles on a round table top."""
    return _joined(_things(), _mosaic(TABLE_RADIUS), _rim())


@lru_cache(maxsize=1)
def pebbles_before_a_wall() -> LitSurface:
    """Return the pebbles on a floor with a round wall. Floor and wall fill every pixel of cameras in front.

    Parts that those cameras cannot see are left out.
    """
    return _joined(_things(), _in_front(_mosaic(ROOM_RADIUS)), _in_front(_wall()))


def distance(points: Reals) -> Reals:
    """Return signed distances (n,) to the pebbles and the ground."""
    parts = [stone.distance(points) for stone in PEBBLES]
    return np.minimum.reduce([*parts, points[:, 2] - GROUND])


def _ellipsoid(points: Reals, radii: ArrayLike) -> Reals:
    """Return the first-order distance f / |grad f| with f = |p / r| - 1."""
    outward = np.linalg.norm(points / radii, axis=1)
    slope = np.linalg.norm(points / np.square(radii), axis=1)
    return np.asarray(outward * (outward - 1) / np.maximum(slope, 1e-9))


def _things() -> LitSurface:
    return _joined(*(_shaded(*surface_of(stone.distance), stone.painted) for stone in PEBBLES))


def surface_of(shape: Callable[[Reals], Reals]) -> tuple[Reals, NDArray[np.int64]]:
    """Return vertices (V, 3) and faces (F, 3), wound outwards, of a shape inside `BOX`."""
    axes = [np.arange(low, high + STEP, STEP) for low, high in BOX.T]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = np.concatenate([shape(plane.reshape(-1, 3)) for plane in grid])
    vertices, faces, _, _ = marching_cubes(values.reshape(grid.shape[:3]), 0.0, spacing=(STEP,) * 3)
    return vertices + BOX[0], faces[:, ::-1].astype(np.int64)


def _stones(points: Reals) -> tuple[Reals, Reals]:
    """Return the colours of the mosaic: rings of stones, where every other ring is turned by half a stone."""
    x, y, _ = points.T
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    ring = np.floor(radius / STONE)
    count = 6 * np.maximum(ring, 1)
    place = turn / (2 * np.pi) * count + 0.5 * (ring % 2)
    kind = (np.floor(place) + ring).astype(int) % len(STONES)
    seam = np.minimum(
        np.abs(radius / STONE - np.round(radius / STONE)) * STONE,
        np.abs(place - np.round(place)) / count * 2 * np.pi * radius,
    )
    shade = 1 - 0.25 * _step(0.014 - seam)
    far = np.clip((radius - 1.7) / 1.5, 0, 1)[:, None]
    return (STONES[kind] * shade[:, None]) * (1 - far) + STONES.mean(axis=0) * far, np.full(len(x), 0.06)


def _step(value: Reals, width: float = 0.012) -> Reals:
    """Return a smooth step: 0 for negative and 1 for positive values, with a transition of `width`."""
    t = np.clip(value / width + 0.5, 0, 1)
    return t * t * (3 - 2 * t)


def _mosaic(radius: float) -> LitSurface:
    radii = [0.0]
    while radii[-1] < radius:
        radii.append(min(radius, radii[-1] + max(0.75 * STEP, 0.02 * (radii[-1] - 1.2))))
    return _shaded(*_rings(np.array(radii), np.full(len(radii), GROUND)), _stones)


def _rim() -> LitSurface:
    vertices, faces = _rings(np.full(2, TABLE_RADIUS), np.array([GROUND, GROUND - 0.08]))
    outward = np.stack([vertices[:, 0], vertices[:, 1], np.zeros(len(vertices))], axis=1) / TABLE_RADIUS
    light = SKY + 0.4 * np.clip(outward @ SUN, 0, 1)
    color = 0.8 * light[:, None] * STONES.mean(axis=0)
    return LitSurface(vertices, faces, color, outward, np.zeros(len(vertices)), SUN)


def _wall() -> LitSurface:
    turns = np.linspace(0, np.pi / 2, 90)
    vertices, faces = _rings(ROOM_RADIUS * np.cos(turns), GROUND + ROOM_RADIUS * np.sin(turns))
    direction = (vertices - (0, 0, GROUND)) / ROOM_RADIUS
    turn, height = np.arctan2(direction[:, 1], direction[:, 0]), direction[:, 2]
    color = SKY_COLORS[0] + np.clip(height * 2.2, 0, 1)[:, None] * (SKY_COLORS[1] - SKY_COLORS[0])
    for level, tone in ((0.20, (0.50, 0.56, 0.58)), (0.11, (0.35, 0.43, 0.40))):
        ridge = level + 0.035 * np.sin(5 * turn + 20 * level) + 0.02 * np.sin(13 * turn)
        color = color + _step(ridge - height, 0.03)[:, None] * (np.array(tone) - color)
    return LitSurface(vertices, faces[:, ::-1], color, -direction, np.zeros(len(vertices)), SUN)


def _in_front(surface: LitSurface) -> LitSurface:
    """Remove the faces behind cameras on the side of negative y."""
    middle = surface.vertices[surface.faces].mean(axis=1)
    faces = surface.faces[middle[:, 1] > -0.25 * ROOM_RADIUS]
    used, faces = np.unique(faces, return_inverse=True)
    return LitSurface(
        surface.vertices[used],
        faces.reshape(-1, 3),
        surface.color[used],
        surface.normal[used],
        surface.sheen[used],
        surface.sun,
    )


def _rings(radii: Reals, heights: Reals) -> tuple[Reals, NDArray[np.int64]]:
    """Return a mesh of rings around the z axis; where the radius grows, faces are wound upwards."""
    count = 720
    turn = np.arange(count) * 2 * np.pi / count
    places = [
        np.stack([r * np.cos(turn), r * np.sin(turn), np.full(count, z)], axis=1)
        for r, z in zip(radii, heights, strict=True)
    ]
    ring, k = np.meshgrid(np.arange(len(radii) - 1) * count, np.arange(count), indexing="ij")
    a, b = (ring + k).ravel(), (ring + (k + 1) % count).ravel()
    faces = np.concatenate([np.stack([a, a + count, b + count], axis=1), np.stack([a, b + count, b], axis=1)])
    return np.concatenate(places), faces


def _shaded(vertices: Reals, faces: NDArray[np.int64], paint: Paint) -> LitSurface:
    """Light a part of the scene: ambient light and sun at each vertex, with occlusion and shadows."""
    albedo, sheen = paint(vertices)
    normal = _normals(vertices)
    facing = np.clip(normal @ SUN, 0, 1)
    sun = _sunlight(vertices + 0.02 * normal) * facing
    light = SKY * _open_sky(vertices, normal) * (0.75 + 0.25 * normal[:, 2]) + 0.85 * sun
    return LitSurface(
        vertices, faces, np.clip(albedo * light[:, None], 0, 1), normal, sheen * (sun > 0) * np.sqrt(sun), SUN
    )


def _normals(vertices: Reals) -> Reals:
    step = 1e-4 * np.eye(3)
    slope = np.stack([distance(vertices + d) - distance(vertices - d) for d in step], axis=1)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)


def _sunlight(points: Reals) -> Reals:
    """Return the visible share (n,) of the sun, computed from the narrowest gap along the ray to the sun."""
    along, share = np.full(len(points), 0.01), np.ones(len(points))
    for _ in range(60):
        gap = distance(points + along[:, None] * SUN)
        share = np.minimum(share, np.clip(0.5 + 0.5 * gap / (SUN_WIDTH * along), 0, 1))
        along = along + np.clip(gap, 0.01, 0.15)
    return share * share * (3 - 2 * share)


def _open_sky(points: Reals, normal: Reals) -> Reals:
    """Return the ambient visibility (n,): the signed distance along the normal relative to the distance
    walked."""
    hidden = np.zeros(len(points))
    for step in (0.04, 0.1, 0.2, 0.35):
        hidden += 0.55 * np.maximum(step - distance(points + step * normal), 0) / step / 2
    return np.clip(1 - hidden, 0.15, 1)


def _joined(*parts: LitSurface) -> LitSurface:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return LitSurface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.color for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.sheen for part in parts]),
        SUN,
    )
