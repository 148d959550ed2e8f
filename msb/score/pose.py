"""Find the similarity between an asset and a capture from the photographs. docs/score.md has the steps."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from msb.score.features import Features, detect_features, match_features, match_nearby
from msb.score.placing import (
    LEAST_INLIERS,
    Matches,
    Reals,
    count_agreeing,
    guess_similarity,
    measure_errors,
    refine_similarity,
    solve_camera,
)

GREY = (0.5, 0.5, 0.5)
# Views around the asset, and pixels along a side of their images.
_AROUND, _SIDE = 72, 480
# Places inside the asset, as multiples of its radius, and views from each.
_PLACES = np.array([(0, 0, 0), *(0.4 * np.eye(3)), *(-0.4 * np.eye(3))])
_DIRECTIONS = 16
# Full angles of view around and inside the asset, in radians.
_ANGLE, _ANGLE_INSIDE = math.radians(50), math.radians(75)
# Distance from the centre of a view around the asset, as a multiple of its radius.
_DISTANCE = 2.6
# Largest number of features of a photograph, of a drawing, and of either in the search for similar views.
_FEATURES, _DRAWN_FEATURES, _FEW = 2000, 1000, 200
# Drawings that each photograph is matched with.
_SIMILAR_VIEWS = 10
# Largest number of photographs that are matched with views around.
MOST_PHOTOGRAPHS = 60
# Search radius in pixels, and number of photographs, of each turn of the refinement.
_TURNS = ((32.0, 12), (16.0, 16), (8.0, 20), (5.0, 30))
# Largest number of guesses that are refined, for each handedness. The best is compared with one of the other
# handedness that has at least this share of its matches.
_GUESSES, _RIVAL = 2, 0.3
# Share of the photographs of the last turn that must agree. Below it, views from inside are tried as well.
_MOST_AGREE = 0.7
# Least number of photographs that agree, and the largest residual in pixels of a found pose.
LEAST_PHOTOGRAPHS, MAX_RESIDUAL = 3, 2.0
# Least share of a photograph's matches in the last turn within this residual; chance gives 0.13. Matches
# beyond `_WITHIN` pixels are outliers, which do not count in the residual.
_MIN_SHARE, _WITHIN = 0.3, 3.0


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph of the search: its camera at the searched size, and its features.

    `scale` is the number of pixels of the searched size per pixel of the photograph.
    """

    camera: Camera
    features: Features
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Pose:
    """Where an asset is in the frame of a capture.

    Attributes
    ----------
    source : {"found", "capture", "file"}
    matrix : (4, 4) float64
        ``capture = matrix @ asset`` for column vectors: scale times rotation, perhaps mirrored, then
        translation.
    photographs : int
        Photographs that agree; 0 unless the pose was found.
    residual : float or None
        Median distance in pixels of the photographs between features and projected points.
    uncertainty : mapping or None
        Standard deviations: "rotation" (degrees), "scale" (ratio), "translation" (units of the capture).
    """

    source: str
    matrix: Reals
    photographs: int = 0
    residual: float | None = None
    uncertainty: dict[str, float] | None = None

    @property
    def mirrored(self) -> bool:
        """Whether the asset is a mirror image of the captured object."""
        return bool(np.linalg.det(self.matrix[:3, :3]) < 0)

    @property
    def scale(self) -> float:
        """Units of the capture per unit of the asset."""
        return float(np.cbrt(abs(np.linalg.det(self.matrix[:3, :3]))))

    def to_dict(self) -> dict[str, object]:
        """Return the JSON data."""
        return {
            "source": self.source,
            "matrix": self.matrix.tolist(),
            "scale": self.scale,
            "mirrored": self.mirrored,
            "photographs": self.photographs,
            "residual": self.residual,
            "uncertainty": self.uncertainty,
        }


class PoseNotFoundError(Exception):
    """Error that the pose of an asset cannot be found, with the reason as its text."""


class _Guess(NamedTuple):
    """A similarity (4, 4) from the normalised, perhaps mirrored asset, and its number of agreeing matches."""

    matrix: Reals
    mirrored: bool
    agreeing: int


class _Drawer(contextlib.ExitStack):
    """Draws an asset in its normalised frame: centre 0, and radius 1. `mirror` also mirrors this frame."""

    def __init__(self, mesh: Mesh, device: str | None) -> None:
        super().__init__()
        self._mesh, self._device = mesh, device
        self._unit = normalise(mesh.vertices, mesh.faces)
        self._renderers: dict[bool, StandardRenderer] = {}
        self.mirror(False)

    def mirror(self, mirrored: bool) -> None:
        """Draw the asset, or its mirror image."""
        self.to_unit = np.diag([-1.0 if mirrored else 1.0, 1, 1, 1]) @ self._unit
        if mirrored not in self._renderers:
            vertices = self._mesh.vertices @ self.to_unit[:3, :3].T + self.to_unit[:3, 3]
            asset = asset_from_mesh(replace(self._mesh, vertices=vertices), origin=(0.0, 0.0, 0.0))
            renderer = StandardRenderer(asset, device=self._device, supersample=2)
            self._renderers[mirrored] = self.enter_context(contextlib.closing(renderer))
        self._renderer = self._renderers[mirrored]

    def draw(self, camera: Camera, most: int) -> tuple[Features, Reals]:
        """Return the features of a drawing at covered pixels, and their points (N, 3) in this frame."""
        frame = self._renderer.render(camera, GREY)
        features = detect_features(frame.image, most, frame.depth > 0)
        column, row = np.floor(features.pixels).astype(int).T
        depth = frame.depth[row, column].astype(np.float64)
        x, y = ((features.pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)).T
        local = np.stack([x * depth, y * depth, depth], axis=1)
        pose = camera.camera_to_world
        return features, local @ pose[:3, :3].T + pose[:3, 3]


def normalise(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Reals:
    """Return the matrix (4, 4) that moves a mesh to centre 0 and radius 1.

    Centre and radius are the median, and the 90th percentile of the distances from it, of the vertices of
    faces, so that floaters do not matter.
    """
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    points = vertices[used].astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    center = np.median(points, axis=0) if len(points) else np.zeros(3)
    distance = np.linalg.norm(points - center, axis=1)
    radius = float(np.quantile(distance, 0.9)) if len(points) else 0.0
    if not radius > 0:
        raise PoseNotFoundError("the asset has no extent")
    matrix = np.diag([1 / radius] * 3 + [1.0])
    matrix[:3, 3] = -center / radius
    return matrix


def find_pose(
    mesh: Mesh,
    photographs: Sequence[Photograph],
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> Pose:
    """Return the pose of `mesh` in the frame of the photographs' cameras.

    Views around the asset are tried first, then also views from inside. `step` is called four times at most.

    Raises
    ------
    PoseNotFoundError
        Too few photographs agree, or the residual is too large.
    """
    rich = sum(len(photograph.features) >= LEAST_INLIERS for photograph in photographs)
    if rich < LEAST_PHOTOGRAPHS:
        text = f"{rich} of {len(photographs)} photographs have enough features; at least 3 must"
        raise PoseNotFoundError(text)
    reason = "no photograph matches a view of the asset"
    found: list[tuple[int, Pose]] = []
    with _Drawer(mesh, device) as drawer:
        for cameras in (_views_around(), _views_inside()):
            drawer.mirror(False)
            seen = [drawer.draw(camera, _DRAWN_FEATURES) for camera in cameras]
            step()
            guesses = [guess for mirrored in (False, True) for guess in _guess(photographs, seen, mirrored)]
            guesses.sort(key=lambda guess: -guess.agreeing)
            step()
            # A part of an object can be symmetric, and a wall seen from behind is its own mirror image. A
            # mirror image then also agrees, with fewer matches.
            refined: dict[bool, tuple[int, Pose]] = {}
            for guess in guesses[: 2 * _GUESSES]:
                is_weak = guess.agreeing < _RIVAL * guesses[0].agreeing
                if guess.mirrored in refined or (refined and is_weak):
                    continue
                try:
                    refined[guess.mirrored] = _refine(drawer, guess, photographs)
                except PoseNotFoundError as error:
                    reason = str(error)
            found += refined.values()
            best = max(found, key=lambda entry: entry[0], default=None)
            # A part of the photographs can also match a part of a room from the wrong side.
            if best is not None and best[1].photographs >= _MOST_AGREE * min(_TURNS[-1][1], len(photographs)):
                break
    if best is None:
        raise PoseNotFoundError(reason)
    return best[1]


def _views_around() -> Iterator[Camera]:
    """Yield cameras on a Fibonacci sphere that look at the centre."""
    for direction in _spread_directions(_AROUND):
        yield _look(_DISTANCE * direction, np.zeros(3), _ANGLE)


def _views_inside() -> Iterator[Camera]:
    """Yield cameras at several places inside that look in all directions."""
    for place in _PLACES:
        for direction in _spread_directions(_DIRECTIONS):
            yield _look(place, place + direction, _ANGLE_INSIDE)


def _look(eye: Reals, target: Reals, angle: float) -> Camera:
    axis = target - eye
    up = np.eye(3)[np.abs(axis).argmin()]
    return Camera.look_at(eye, target, up=up, width=_SIDE, height=_SIDE, fov_y=angle)


def _spread_directions(count: int) -> Reals:
    """Return unit vectors (count, 3) on a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _match_all(photographs: Sequence[Photograph], seen: Sequence[tuple[Features, Reals]]) -> list[Matches]:
    """Return the matches of each photograph with its most similar drawings."""
    few = [features.select(slice(_FEW)) for features, _ in seen]
    numbers = np.repeat(np.arange(len(few)), [len(features) for features in few])
    every = np.concatenate([features.descriptors for features in few])
    matches = []
    for photograph in photographs:
        points, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
        if len(every):
            # Each of the strongest features votes for the drawings of its most similar features.
            similar = photograph.features.select(slice(_FEW)).descriptors @ every.T
            votes = np.zeros(len(seen))
            for row in similar:
                best = np.argpartition(row, -min(5, len(row)))[-5:]
                np.add.at(votes, numbers[best], np.maximum(row[best] - 0.7, 0))
            for number in np.argsort(-votes, kind="stable")[:_SIMILAR_VIEWS]:
                features, places = seen[number]
                pairs = match_features(photograph.features, features)
                points.append(places[pairs[:, 1]])
                pixels.append(photograph.features.pixels[pairs[:, 0]])
        matches.append(Matches(photograph.camera, np.concatenate(points), np.concatenate(pixels)))
    return matches


def _guess(
    photographs: Sequence[Photograph], seen: Sequence[tuple[Features, Reals]], mirrored: bool
) -> list[_Guess]:
    """Return the similarities that most matches agree with, the best first."""
    if mirrored:
        seen = [(features.mirrored(), points * (-1, 1, 1)) for features, points in seen]
    matches = _match_all(photographs, seen)
    solved = [(camera, match) for match in matches if (camera := solve_camera(match)) is not None]
    rough = [guess_similarity(camera, match, matches) for camera, match in solved]
    rough.sort(key=lambda matrix: -count_agreeing(matrix, matches))
    guesses = []
    for matrix in rough[:_GUESSES]:
        for reach in (24.0, 12.0):
            matrix, _ = refine_similarity(matrix, matches, reach)
        guesses.append(_Guess(matrix, mirrored, count_agreeing(matrix, matches)))
    return guesses


def _refine(drawer: _Drawer, guess: _Guess, photographs: Sequence[Photograph]) -> tuple[int, Pose]:
    """Return the pose after turns of drawing the asset from the photographs' cameras and matching again.

    The number of agreeing matches is returned as well.
    """
    drawer.mirror(guess.mirrored)
    matrix = guess.matrix
    chosen = list(photographs)
    matches: list[Matches] = []
    covariance = np.zeros((7, 7))
    for radius, most in _TURNS:
        chosen = [photographs[k] for k in spread_numbers(len(photographs), most)]
        matches = [_match_drawn(drawer, matrix, photograph, radius) for photograph in chosen]
        errors = np.concatenate(measure_errors(matrix, matches))
        if len(errors) < LEAST_INLIERS:
            raise PoseNotFoundError("no photograph looks like the asset from its camera")
        for reach in (radius, max(3.0, radius / 4)):
            matrix, covariance = refine_similarity(matrix, matches, reach)
    return _judge(drawer, matrix, matches, covariance, [photograph.scale for photograph in chosen])


def spread_numbers(count: int, most: int) -> list[int]:
    """Return at most `most` of the numbers below `count`, spread evenly."""
    return [k * count // most for k in range(most)] if count > most else list(range(count))


def _match_drawn(drawer: _Drawer, matrix: Reals, photograph: Photograph, radius: float) -> Matches:
    """Return the matches of a photograph with a drawing from its camera, within `radius` pixels."""
    # The rigid part of (camera pose) @ matrix sees the same image; depths are those of the asset.
    pose = photograph.camera.world_to_camera @ matrix
    scale = np.cbrt(np.linalg.det(pose[:3, :3]))
    pose[:3] /= scale
    left, _, right = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = left @ right
    features, points = drawer.draw(replace(photograph.camera, world_to_camera=pose, unit=1.0), _FEATURES)
    pairs = match_nearby(photograph.features, features, radius)
    return Matches(photograph.camera, points[pairs[:, 1]], photograph.features.pixels[pairs[:, 0]])


def _judge(
    drawer: _Drawer, matrix: Reals, matches: Sequence[Matches], covariance: Reals, scales: Sequence[float]
) -> tuple[int, Pose]:
    """Return the pose, with its agreeing matches, if enough photographs agree and the residual is small."""
    errors = [error / scale for error, scale in zip(measure_errors(matrix, matches), scales, strict=True)]
    # Chance matches are spread evenly within the radius of the last turn.
    good = [error[error < MAX_RESIDUAL] for error in errors]
    agreeing = [
        error[error < _WITHIN]
        for error, near in zip(errors, good, strict=True)
        if len(near) >= LEAST_INLIERS and len(near) >= _MIN_SHARE * len(error)
    ]
    if len(agreeing) < LEAST_PHOTOGRAPHS:
        text = f"{len(agreeing)} of {len(matches)} photographs agree on a pose; at least 3 must"
        raise PoseNotFoundError(text)
    residual = float(np.median(np.concatenate(agreeing)))
    if residual > MAX_RESIDUAL:
        raise PoseNotFoundError(
            f"the residual of the best pose is {residual:.1f} pixels; at most 2 are allowed"
        )
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0))
    uncertainty = {
        "rotation": float(np.degrees(np.linalg.norm(spread[:3]))),
        "scale": float(spread[3]),
        "translation": float(np.linalg.norm(spread[4:]) * scale),
    }
    count = sum(map(len, good))
    return count, Pose("found", matrix @ drawer.to_unit, len(agreeing), residual, uncertainty)
