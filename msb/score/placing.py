"""Similarities between the frames of an asset and of a capture: hypotheses, votes and refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera

Reals = NDArray[np.float64]

# Pixels within which a projected point agrees with its feature when hypotheses are compared.
_NEAR = 8.0
# Width of the window, in natural logarithms, in which matches vote for the same scale.
_SCALE_WINDOW = 0.03
# Least number of agreeing matches of a solved camera.
LEAST_INLIERS = 12
# RANSAC: samples, and pixels within which a match agrees with a camera.
_SAMPLES, _AGREE = 1000, 6.0
# Pixels beyond which the refinement gives a match less weight.
_HUBER = 1.0


@dataclass(frozen=True, eq=False)
class Matches:
    """Matches of one photograph: `points` (N, 3) of the asset, and the `pixels` (N, 2) that show them."""

    camera: Camera
    points: Reals
    pixels: Reals


def project(matrix: Reals, camera: Camera, points: Reals) -> Reals:
    """Return the pixels (N, 2) of asset points after the similarity `matrix` (4, 4); inf behind the camera.

    The capture's frame is ``matrix @ asset`` for column vectors.
    """
    pixels, _ = camera.project(points @ matrix[:3, :3].T + matrix[:3, 3])
    return np.nan_to_num(pixels, nan=np.inf)


def measure_errors(matrix: Reals, matches: Sequence[Matches]) -> list[Reals]:
    """Return for each photograph the distances (N,) in pixels of projected points from their features."""
    return [
        np.linalg.norm(project(matrix, match.camera, match.points) - match.pixels, axis=1)
        for match in matches
    ]


def solve_camera(match: Matches) -> tuple[Reals, Reals, int] | None:
    """Return rotation (3, 3), translation (3,) of the photograph's camera in the asset's frame, and inliers.

    None if fewer than `LEAST_INLIERS` matches agree. Perspective-n-point by RANSAC of OpenCV.
    """
    import cv2

    if len(match.points) < LEAST_INLIERS:
        return None
    cv2.setRNGSeed(0)
    found, turn, move, inliers = cv2.solvePnPRansac(
        match.points,
        match.pixels,
        match.camera.K,
        None,
        iterationsCount=_SAMPLES,
        reprojectionError=_AGREE,
        confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or inliers is None or len(inliers) < LEAST_INLIERS:
        return None
    rows = inliers[:, 0]
    turn, move = cv2.solvePnPRefineLM(
        match.points[rows], match.pixels[rows], match.camera.K, None, turn, move
    )
    rotation = cv2.Rodrigues(turn)[0]
    return np.asarray(rotation, np.float64), np.asarray(move, np.float64)[:, 0], len(rows)


def guess_similarity(solved: tuple[Reals, Reals, int], match: Matches, matches: Sequence[Matches]) -> Reals:
    """Return the similarity (4, 4) of one solved camera, whose scale all other photographs vote for.

    A solved camera fixes rotation and centre. With scale s a point X of the asset is at
    ``centre + s rotation (X - solved centre)``. In another photograph it moves along an epipolar line with s.
    A match whose feature is near this line gives one s, its vote.
    """
    rotation, move, _ = solved
    pose = match.camera.world_to_camera
    turn = pose[:3, :3].T @ rotation
    center, solved_center = match.camera.center, -rotation.T @ move
    votes = [np.zeros(0)]
    for other in matches:
        if other is match or not len(other.points):
            continue
        camera = other.camera
        # The ray of each feature, and the point a + s b in camera coordinates, all (N, 3).
        ray = np.c_[
            (other.pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(len(other.pixels))
        ]
        a = camera.world_to_camera[:3, :3] @ center + camera.world_to_camera[:3, 3]
        b = (other.points - solved_center) @ (camera.world_to_camera[:3, :3] @ turn).T
        across_a, across_b = np.cross(ray, a), np.cross(ray, b)
        scale = -(across_a * across_b).sum(axis=1) / np.maximum((across_b**2).sum(axis=1), 1e-300)
        place = a + scale[:, None] * b
        with np.errstate(all="ignore"):
            off = np.abs(place[:, :2] / place[:, 2:] - ray[:, :2]).max(axis=1) * camera.fx
        votes.append(np.log(scale[(scale > 0) & (place[:, 2] > 0) & (off < _NEAR)]))
    cast = np.sort(np.concatenate(votes))
    matrix = np.eye(4)
    scale_found = 1.0
    if len(cast):
        counts = np.searchsorted(cast, cast + _SCALE_WINDOW) - np.arange(len(cast))
        start = int(counts.argmax())
        scale_found = float(np.exp(np.median(cast[start : start + counts[start]])))
    matrix[:3, :3] = scale_found * turn
    matrix[:3, 3] = center - matrix[:3, :3] @ solved_center
    return matrix


def count_agreeing(matrix: Reals, matches: Sequence[Matches]) -> int:
    """Return the number of matches within `_NEAR` pixels; a photograph counts at most 50."""
    return sum(min(int((errors < _NEAR).sum()), 50) for errors in measure_errors(matrix, matches))


def refine_similarity(
    matrix: Reals, matches: Sequence[Matches], reach: float, rounds: int = 12
) -> tuple[Reals, Reals]:
    """Return the similarity with the least robust reprojection error, and its covariance (7, 7).

    Gauss-Newton with Huber weights over seven parameters: rotation vector (radians), logarithm of the scale,
    translation (units of the asset). Matches farther than `reach` pixels have no weight.
    """
    cameras = [match for match in matches if len(match.points)]
    normal = np.eye(7)
    variance = 0.0
    for _ in range(rounds):
        error = _residuals(matrix, cameras)
        distance = np.linalg.norm(error, axis=1)
        weight = np.where(distance < reach, _HUBER / np.maximum(distance, _HUBER), 0.0)
        weight[~np.isfinite(distance)] = 0
        if (weight > 0).sum() < LEAST_INLIERS:
            break
        # Numerical Jacobian (N, 2, 7) of the pixels.
        step = 1e-6
        with np.errstate(invalid="ignore"):  # points behind a camera are infinitely far from their pixels
            columns = [
                (_residuals(matrix @ _move(step * axis), cameras) - error) / step for axis in np.eye(7)
            ]
        jacobian = np.stack(columns, axis=2)
        rows = weight > 0
        scaled = jacobian[rows] * weight[rows, None, None]
        normal = np.einsum("nik,nil->kl", scaled, jacobian[rows])
        change = -np.linalg.lstsq(normal, np.einsum("nik,ni->k", scaled, error[rows]), rcond=1e-12)[0]
        matrix = matrix @ _move(np.clip(change, -0.3, 0.3))
        variance = float((weight[rows] * distance[rows] ** 2).sum() / max(1, 2 * rows.sum() - 7))
        if np.abs(change).max() < 1e-8:
            break
    return matrix, np.asarray(np.linalg.pinv(normal) * variance, np.float64)


def _residuals(matrix: Reals, matches: Sequence[Matches]) -> Reals:
    """Return projected minus observed pixels (N, 2) of all matches."""
    return np.concatenate([project(matrix, match.camera, match.points) - match.pixels for match in matches])


def _move(values: Reals) -> Reals:
    """Return the small similarity (4, 4) of a rotation vector, a logarithm of scale and a translation."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = np.exp(values[3]) * Rotation.from_rotvec(values[:3]).as_matrix()
    matrix[:3, 3] = values[4:]
    return matrix
