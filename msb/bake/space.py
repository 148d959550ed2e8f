"""The space in which a surface is made: the world about what is looked at, what is far drawn together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from msb.bake.arrays import Floats

if TYPE_CHECKING:
    from msb.scenes import Camera


_FAR_SHARE = 0.02  # share of visible points beyond the cameras above which the model is a scene
_NEAR = 0.5  # radius of a scene that is left undistorted, in median camera distances
_TRIM = 0.1  # percentage of visible points that may lie outside an object's box, at each side
_PARALLEL = 1e-3  # least conditioning of the point that camera axes meet in, in its worst direction
# Least distance of the meeting point in front of the cameras, relative to the visible points. Cameras
# that turn in one place meet where they stand.
_AHEAD = 1e-4
# Distance of the visible centre from the cameras, in the same unit, below which they stand inside.
_AMID = 0.5
_THIN = 1e-3  # half the shortest side of an object's box, relative to its longest
EDGE = 1.96  # outer radius of a scene's grid; 2 is infinitely far


@dataclass(frozen=True, eq=False)
class Space:
    """Places inside: those of the world less `center`, in units of `radius`, and drawn together if so said.

    Drawing together leaves the ball of radius 1 as it is and takes x beyond it to (2 - 1 / |x|) x / |x|, as
    Mip-NeRF 360 does (Barron et al. 2022), so that what is far gets as many cells and faces as it has
    pixels. It is continuous and can be undone, so that a closed manifold stays one.

    Attributes
    ----------
    center : (3,) float64
    radius : float
    contracted : bool
    low, high : (3,) float64
        The box of what is seen, inside.
    """

    center: Floats
    radius: float
    contracted: bool
    low: Floats
    high: Floats

    @classmethod
    def of(cls, points: Floats, cameras: Sequence[Camera]) -> Self:
        """Return the space for what cameras see at `points` (n, 3) of the world, n > 0."""
        at = np.stack([camera.center for camera in cameras])
        off = float(np.median(np.linalg.norm(points - at.mean(axis=0), axis=1)))
        point = _looked_at(cameras, _AHEAD * off)
        focus = np.median(points, axis=0) if point is None else point
        distance = float(np.median(np.linalg.norm(at - focus, axis=1)))
        # Of cameras that turn in one place how far apart they are says nothing of what is round them.
        is_amid = point is None and distance < _AMID * off
        distance = off if is_amid else distance
        if is_amid or (np.linalg.norm(points - focus, axis=1) > distance).mean() > _FAR_SHARE:
            edge = np.full(3, EDGE)
            return cls(focus, _NEAR * distance, True, -edge, edge)
        low, high = np.percentile(points, [_TRIM, 100 - _TRIM], axis=0)
        center, radius = (low + high) / 2, float((high - low).max() / 2)
        radius = radius or distance
        half = np.maximum((high - low) / 2 / radius, _THIN)
        return cls(center, radius, False, -half, half)

    def inward(self, points: Floats) -> Floats:
        """Return places (n, 3) of the world inside."""
        x: Floats = (points - self.center) / self.radius
        if not self.contracted:
            return x
        far = np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1)
        drawn: Floats = x * (2 - 1 / far) / far
        return drawn

    def outward(self, points: Floats) -> Floats:
        """Return places (n, 3) inside in the world."""
        placed: Floats = self.center + self.radius * points * self._stretch(points)[0]
        return placed

    def held(self, points: Floats) -> Floats:
        """Return places inside with those that left it, which a scene's may, back at its edge."""
        if not self.contracted:
            return points
        size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        kept: Floats = points * np.minimum(1, EDGE / size)
        return kept

    def pulled(self, points: Floats, slopes: Floats) -> Floats:
        """Return how something changes with places inside, from how it does with those in the world."""
        across, along = self._stretch(points)
        size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        direction = points / size
        radial = (slopes * direction).sum(axis=1, keepdims=True) * direction
        found: Floats = self.radius * (across * (slopes - radial) + along * radial)
        return found

    def _stretch(self, points: Floats) -> tuple[Floats, Floats]:
        """Return by what (n, 1) lengths grow outward: across the direction to the centre, and along it."""
        size = np.linalg.norm(points, axis=1, keepdims=True)
        if not self.contracted:
            return np.ones_like(size), np.ones_like(size)
        far = np.maximum(size, 1)
        left = np.maximum(2 - far, 0.01)
        return 1 / (far * left), 1 / left**2


def _looked_at(cameras: Sequence[Camera], ahead: float) -> Floats | None:
    """Return the point that cameras look at, farther `ahead` of each than that; None if there is none."""
    at = np.stack([camera.center for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _PARALLEL * len(cameras):
        return None
    found: Floats = np.linalg.solve(total, np.einsum("nij,nj->i", across, at))
    in_front = ((found - at) * axes).sum(axis=1) > ahead
    return found if in_front.all() else None
