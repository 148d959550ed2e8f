"""Cameras between those of a capture, for whoever can draw what they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msb.scenes.camera import Camera
from msb.scenes.paths import interpolated
from msb.scenes.walk import looked_at, radius_of

_DIGITS = 6
"""Of a gap: where several are alike, the last bit does not choose."""


def between(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return at most `count` cameras more, each halfway between two of `cameras` or of those made before.

    Each next one is the farthest from every other of those halfway between two neighbours, so that the widest
    gaps are closed first. Two are neighbours if none is nearer to halfway between them, and one is turned by
    less than 120 degrees to become the other: on a way half round an object nobody may have stood. How far
    apart two are is the angle between their axes, in radians, and the distance of their centres in radii of
    the capture. There are fewer cameras where those given are alone, stand together, or opposite.
    """
    aim = looked_at(cameras)
    every = list(cameras)
    radius = radius_of(cameras) or 1.0
    while len(every) < len(cameras) + count:
        poses = np.stack([camera.world_to_camera for camera in every])
        turns = poses[:, :3, :3]
        # The trace of the rotation from one to the other is 1 + 2 cos of its angle.
        pairs = np.argwhere(np.triu(np.einsum("mij,nij->mn", turns, turns) > 0, 1))
        halfway = _halfway(poses[pairs[:, 0]], poses[pairs[:, 1]], aim)
        gaps = _gaps(halfway, poses, radius)
        widest = gaps.min(axis=1)
        widest[widest < np.take_along_axis(gaps, pairs, axis=1).min(axis=1)] = 0  # they are no neighbours
        if not widest.any():
            break
        best = int(widest.argmax())
        lens = interpolated([every[number] for number in pairs[best]], 3)[1]
        name = f"between_{len(every) - len(cameras):05d}"
        every.append(replace(lens, world_to_camera=halfway[best], name=name, image_path=None, split=None))
    return every[len(cameras) :]


def _halfway(
    ones: NDArray[np.float64], others: NDArray[np.float64], aim: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) halfway between two each, on an arc round `aim` where both look towards it.

    The point that lies as far before them as `aim` moves along a line, and so does its distance from them.
    Where `aim` is behind them, as in a room, they move along it themselves.
    """
    left, _, right = np.linalg.svd(ones[:, :3, :3] + others[:, :3, :3])
    made = ones.copy()
    made[:, :3, :3] = left @ right
    away = np.zeros(len(made))
    seen = np.zeros((len(made), 3))
    for pose in (ones, others):
        far = np.maximum(pose[:, 2, :3] @ aim + pose[:, 2, 3], 0)
        away += far / 2
        seen += (_centers(pose) + far[:, None] * pose[:, 2, :3]) / 2
    center = seen - away[:, None] * made[:, 2, :3]
    made[:, :3, 3] = -np.einsum("nij,nj->ni", made[:, :3, :3], center)
    return made


def _centers(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where cameras stand, (N, 3)."""
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def _gaps(ones: NDArray[np.float64], others: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return how far apart the poses of two sets are, (N, M)."""
    turned = np.arccos((ones[:, 2, :3] @ others[:, 2, :3].T).clip(-1, 1))
    moved = np.linalg.norm(_centers(ones)[:, None] - _centers(others), axis=2)
    return np.asarray((turned + moved / radius).round(_DIGITS))
