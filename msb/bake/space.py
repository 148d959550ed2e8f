"""Coordinates for making a surface: world coordinates with distant parts contracted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from msb.bake.arrays import Floats

if TYPE_CHECKING:
    from msb.scenes import Camera

# A model is a scene if more than this share of the visible points is farther from the focus than the cameras.
# Otherwise the model counts as an object.
_SCENE_SHARE = 0.02
# Radius of the uncontracted part of a scene. The unit is the median distance of the cameras from the focus.
_NEAR_RADIUS = 0.5
# An object's box may exclude this percentage of the visible points at each side, because some faces are
# stray.
_TRIM_PERCENT = 0.1
# The focus is the point nearest to all camera axes. This point is the solution of a linear system of
# equations. Camera axes count as parallel if the system is badly conditioned. The limit applies to the
# smallest eigenvalue of the system, divided by the number of cameras.
_MIN_CONDITIONING = 1e-3
# Smallest distance of the focus in front of the cameras. The value is relative to the distance of the
# visible points. If all cameras are at one place, their axes meet there, and the focus is invalid.
_MIN_AHEAD = 1e-4
# The cameras are inside the model if the visible centre is nearer to the cameras than this distance. The
# distance is relative to the distance of the visible points.
_INSIDE_DISTANCE = 0.5
# Smallest side of an object's box relative to its longest side, so that a flat object still has a volume.
_MIN_THICKNESS = 1e-3
# Outer radius of a scene's grid in contracted coordinates: 1.96 means 25 near radii, and 2 means infinity.
EDGE = 1.96


@dataclass(frozen=True, eq=False)
class Space:
    """Coordinates relative to `center` in units of `radius`, contracted for scenes.

    The contraction leaves the unit ball unchanged and maps x beyond it to (2 - 1 / |x|) x / |x|, as in
    Mip-NeRF 360 (Barron et al. 2022). Distant parts therefore get grid cells and faces in proportion to their
    pixels. The contraction is continuous and invertible, so a closed manifold stays a closed manifold.

    Attributes
    ----------
    center : (3,) float64
    radius : float
    contracted : bool
    low, high : (3,) float64
        The box of the visible points in these coordinates.
    """

    center: Floats
    radius: float
    contracted: bool
    low: Floats
    high: Floats

    @classmethod
    def fit(cls, points: Floats, cameras: Sequence[Camera]) -> Self:
        """Return the space for the world points (n, 3) that cameras see, n > 0."""
        at = np.stack([camera.center for camera in cameras])
        offset = float(np.median(np.linalg.norm(points - at.mean(axis=0), axis=1)))
        focus = _find_focus(cameras, _MIN_AHEAD * offset)
        center = np.median(points, axis=0) if focus is None else focus
        distance = float(np.median(np.linalg.norm(at - center, axis=1)))
        # If all cameras are at one place, their distances do not indicate the size of the scene.
        is_inside = focus is None and distance < _INSIDE_DISTANCE * offset
        distance = offset if is_inside else distance
        if is_inside or (np.linalg.norm(points - center, axis=1) > distance).mean() > _SCENE_SHARE:
            edge = np.full(3, EDGE)
            return cls(center, _NEAR_RADIUS * distance, True, -edge, edge)
        # For an object, use the box of its visible points.
        low, high = np.percentile(points, [_TRIM_PERCENT, 100 - _TRIM_PERCENT], axis=0)
        center, radius = (low + high) / 2, float((high - low).max() / 2)
        radius = radius or distance
        half = np.maximum((high - low) / 2 / radius, _MIN_THICKNESS)
        return cls(center, radius, False, -half, half)

    def from_world(self, points: Floats) -> Floats:
        """Convert world points (n, 3) to coordinates of this space."""
        x: Floats = (points - self.center) / self.radius
        if not self.contracted:
            return x
        size = np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1)
        contracted: Floats = x * (2 - 1 / size) / size
        return contracted

    def to_world(self, points: Floats) -> Floats:
        """Convert points (n, 3) in coordinates of this space to world coordinates."""
        placed: Floats = self.center + self.radius * points * self._stretch(points)[0]
        return placed

    def clamp(self, points: Floats) -> Floats:
        """Return the points. Points beyond the edge of a scene are moved back to the edge."""
        if not self.contracted:
            return points
        size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        clamped: Floats = points * np.minimum(1, EDGE / size)
        return clamped

    def pull_back(self, points: Floats, gradients: Floats) -> Floats:
        """Convert gradients (n, 3) from world coordinates to coordinates of this space."""
        across, along = self._stretch(points)
        size = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        direction = points / size
        radial = (gradients * direction).sum(axis=1, keepdims=True) * direction
        result: Floats = self.radius * (across * (gradients - radial) + along * radial)
        return result

    def _stretch(self, points: Floats) -> tuple[Floats, Floats]:
        """Return two factors (n, 1) that convert lengths to world coordinates, without the constant factor
        `radius`.

        The first factor applies to lengths perpendicular to the direction to the centre. The second factor
        applies to lengths along this direction.
        """
        size = np.linalg.norm(points, axis=1, keepdims=True)
        if not self.contracted:
            return np.ones_like(size), np.ones_like(size)
        size = np.maximum(size, 1)
        left = np.maximum(2 - size, 0.01)
        return 1 / (size * left), 1 / left**2


def _find_focus(cameras: Sequence[Camera], ahead: float) -> Floats | None:
    """Return the point nearest to all camera axes.

    Return None if the point is less than `ahead` in front of a camera.
    """
    # Solve a least-squares system. The matrix (3, 3) is the sum of the projections perpendicular to each
    # camera axis.
    at = np.stack([camera.center for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _MIN_CONDITIONING * len(cameras):
        return None
    focus: Floats = np.linalg.solve(total, np.einsum("nij,nj->i", across, at))
    is_ahead = ((focus - at) * axes).sum(axis=1) > ahead
    return focus if is_ahead.all() else None
