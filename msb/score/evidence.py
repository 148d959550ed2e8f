"""What gives away an asset that raises the PSNR without being the thing: flags, and their measurements."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.origin import world_positions
from msb.render.standard.renderer import StandardRenderer
from msb.scenes.walk import measure_radius
from msb.score.capture import Capture
from msb.score.features import detect_features, match_features, match_nearby
from msb.score.pictures import Picture
from msb.score.placing import Reals
from msb.score.pose import GREY, MAX_RESIDUAL, Photograph, Pose, spread_numbers

# Photographs that test the surface, and pairs of neighbours of each.
_TESTED, _NEIGHBOURS = 16, 3
# Pixels of the searched photographs: the largest distance of a match from its epipolar line, and between the
# pixel that the surface predicts in another photograph and the match.
_EPIPOLAR, _PREDICTED = 1.5, 4.0
# Pixels within which features of photographs are searched in drawings.
_SEARCH = 16.0
# Least motion in pixels between two photographs that a surface must explain, beyond a turn of the camera.
_MOTION = 12.0
# Least number of matches for a judgement.
_LEAST_MATCHES = 100
# Least number of features of all tested photographs for a judgement of the alignment.
_LEAST_FEATURES = 500
# Surface points of each tested photograph, and the relative depth within which another one sees a point.
_POINTS, _SAME_DEPTH = 400, 0.02

# Limits of the flags. The docs list them.
MIN_COVERED, MIN_MASK = 0.1, 0.5
MIN_PARALLAX = 0.4
MAX_SINGLE_VIEW = 0.5
MAX_BEHIND = 0.8
MIN_CONTRAST = 6 / 255
MIN_ALIGNED = 0.02
MAX_SCALE = 1e3


@dataclass(frozen=True)
class Evidence:
    """Measurements of an asset in a capture; None where there is nothing to measure.

    Attributes
    ----------
    aligned : float or None
        Share of the features of the photographs that have a match in the drawing within 2 pixels. Good meshes
        have 0.2 to 0.5, and noisy ones 0.05.
    features : int
        The number of features of the photographs that were searched in drawings.
    parallax : float or None
        Share of the matches between photographs whose motion the surface explains.
    parallax_matches : int
        The number of these matches.
    single_view : float or None
        Share of the visible surface, by pixels, that only one of the tested photographs shows.
    behind : float or None
        Share of the visible surface that is seen from behind, in the asset's own frame.
    contrast : float or None
        The range of brightness, in [0, 1], of 80 % of the covered pixels: in the drawings, or in the
        photographs if it is smaller there.
    psnr_near, psnr_far : float or None
        Average PSNR in dB of the half of the held-out views that is nearer to a training view, and of the
        other half.
    """

    aligned: float | None = None
    features: int = 0
    parallax: float | None = None
    parallax_matches: int = 0
    single_view: float | None = None
    behind: float | None = None
    contrast: float | None = None
    psnr_near: float | None = None
    psnr_far: float | None = None

    def to_dict(self) -> dict[str, float | None]:
        """Return the JSON data."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class Flag:
    """A reason to distrust a score: its code, and a sentence with the measurement."""

    code: str
    sentence: str


@dataclass(frozen=True, eq=False)
class _Surface:
    """What one photograph's camera sees of an asset: depth (H, W), 0 for background, and face ids."""

    photograph: Photograph
    depth: NDArray[np.float32]
    face_id: NDArray[np.int32]

    def points_at(self, pixels: Reals) -> tuple[Reals, NDArray[np.int32]]:
        """Return the surface points (N, 3) in the world at pixels (N, 2), NaN for background, and faces."""
        camera = self.photograph.camera
        column, row = np.clip(np.floor(pixels), 0, (camera.width - 1, camera.height - 1)).astype(int).T
        depth = self.depth[row, column].astype(np.float64)
        depth[depth == 0] = np.nan
        rays = np.c_[(pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(len(pixels))]
        pose = camera.camera_to_world
        return (rays * depth[:, None]) @ pose[:3, :3].T + pose[:3, 3], self.face_id[row, column]

    def sees(self, points: Reals) -> NDArray[np.bool_]:
        """Return whether each world point (N, 3) is in the image and not hidden."""
        camera = self.photograph.camera
        pixels, depth = camera.project(points)
        inside = np.asarray(((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1))
        column, row = np.where(inside[:, None], np.floor(pixels), 0).astype(int).T
        seen = self.depth[row, column]
        return np.asarray(inside & (np.abs(seen - depth) <= _SAME_DEPTH * depth))


def gather_evidence(
    asset: Asset,
    capture: Capture,
    pose: Pose,
    pictures: Sequence[Picture],
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> Evidence:
    """Return the measurements of an asset in the frame of the capture."""
    photographs = capture.photographs(step)
    tested = [photographs[k] for k in spread_numbers(len(photographs), _TESTED)]
    surfaces, distances = [], [np.zeros(0)]
    with contextlib.closing(StandardRenderer(asset, device=device)) as renderer:
        for photograph in tested:
            frame = renderer.render(photograph.camera.in_units(asset.manifest.origin), GREY)
            assert frame.face_id is not None, "the standard tier has face ids"
            depth = frame.depth * np.float32(photograph.camera.unit)
            surfaces.append(_Surface(photograph, depth, frame.face_id))
            # Search each feature of the photograph in the drawing.
            drawn = detect_features(frame.image, len(photograph.features) or 1, depth > 0)
            pairs = match_nearby(photograph.features, drawn, _SEARCH)
            moved = photograph.features.pixels[pairs[:, 0]] - drawn.pixels[pairs[:, 1]]
            distances.append(np.linalg.norm(moved, axis=1) / photograph.scale)
            step()
    apart = np.concatenate(distances)
    explained, count = _measure_parallax(surfaces, photographs)
    single, behind = _measure_sides(asset, surfaces)
    if behind is not None and pose.mirrored:  # the mirrored copy that was drawn has its faces reversed
        behind = 1 - behind
    near, far = _split_by_distance(capture, pictures)
    features = sum(len(photograph.features) for photograph in tested)
    aligned = float((apart < MAX_RESIDUAL).sum() / features) if features >= _LEAST_FEATURES else None
    return Evidence(
        aligned, features, explained, count, single, behind, _measure_contrast(pictures), near, far
    )


def _measure_parallax(
    surfaces: Sequence[_Surface], photographs: Sequence[Photograph]
) -> tuple[float | None, int]:
    """Return the share of matches between photographs that the surface explains, and their number.

    A match of two photographs that fits their epipolar geometry shows one point of the real thing. The
    surface at its pixel in the first photograph predicts the pixel in the second. Matches that move less than
    `_MOTION` pixels more than points at infinity say nothing and are left out.
    """
    centers = np.stack([photograph.camera.center for photograph in photographs])
    explained = []
    for surface in surfaces:
        first = surface.photograph
        distance = np.linalg.norm(centers - first.camera.center, axis=1)
        distance[distance < 1e-9] = np.inf
        for number in np.argsort(distance, kind="stable")[:_NEIGHBOURS]:
            second = photographs[number]
            pairs = match_features(first.features, second.features)
            a, b = first.features.pixels[pairs[:, 0]], second.features.pixels[pairs[:, 1]]
            off, motion = _compare_rays(first, second, a, b)
            points, _ = surface.points_at(a)
            predicted, _ = second.camera.project(points)
            error = np.linalg.norm(predicted - b, axis=1)
            counted = (off < _EPIPOLAR) & (motion > _MOTION) & np.isfinite(points[:, 0])
            explained.append(error[counted] < _PREDICTED)
    every = np.concatenate(explained) if explained else np.zeros(0, bool)
    return (float(every.mean()) if len(every) >= _LEAST_MATCHES else None), len(every)


def _compare_rays(first: Photograph, second: Photograph, a: Reals, b: Reals) -> tuple[Reals, Reals]:
    """Return for N matches the distance from the epipolar line, and the motion along it, both in pixels.

    The motion is that of the point relative to a point at infinity on the same ray of the first camera.
    """
    move = second.camera.world_to_camera @ first.camera.camera_to_world
    one, two = first.camera, second.camera
    rays = np.c_[(a - (one.cx, one.cy)) / (one.fx, one.fy), np.ones(len(a))] @ move[:3, :3].T
    with np.errstate(all="ignore"):
        far = rays[:, :2] / rays[:, 2:] * (two.fx, two.fy) + (two.cx, two.cy)
        # The line runs from the point at infinity to the image of the first camera's centre.
        direction = (move[:2, 3] - rays[:, :2] / rays[:, 2:] * move[2, 3]) * (two.fx, two.fy)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        change = b - far
        along = (change * direction).sum(axis=1)
        off = np.abs(change[:, 0] * direction[:, 1] - change[:, 1] * direction[:, 0])
    return np.nan_to_num(off, nan=np.inf), np.nan_to_num(np.abs(along), nan=0.0)


def _measure_sides(asset: Asset, surfaces: Sequence[_Surface]) -> tuple[float | None, float | None]:
    """Return the shares of the visible surface that a single view shows, and that is seen from behind."""
    random = np.random.default_rng(0)
    positions, faces = world_positions(asset), asset.buffers["indices"]
    single, behind = [], []
    for number, surface in enumerate(surfaces):
        rows, columns = np.nonzero(surface.depth > 0)
        if not len(rows):
            continue
        chosen = random.integers(0, len(rows), _POINTS)
        pixels = np.stack([columns[chosen], rows[chosen]], axis=1).astype(np.float64) + 0.5
        points, face = surface.points_at(pixels)
        others = [other.sees(points) for k, other in enumerate(surfaces) if k != number]
        single.append(~np.any([*others, np.zeros(len(points), bool)], axis=0))
        # The normal (N, 3) of each visible face, and whether it points away from the camera.
        a, b, c = (positions[faces[face, k]].astype(np.float64) for k in range(3))
        normal = np.cross(b - a, c - a)
        behind.append(((surface.photograph.camera.center - points) * normal).sum(axis=1) < 0)
    if not single:
        return None, None
    return float(np.concatenate(single).mean()), float(np.concatenate(behind).mean())


def _measure_contrast(pictures: Sequence[Picture]) -> float | None:
    """Return the smaller contrast of brightness of drawings and photographs at covered pixels.

    Quantiles ignore the edges of a drawing, where the grey background shines through.
    """
    drawn = [picture.image[picture.covered].mean(axis=1) / 255 for picture in pictures]
    photographed = [picture.view.photograph[picture.covered].mean(axis=1) for picture in pictures]
    if not sum(map(len, drawn)):
        return None
    quantiles = (np.quantile(np.concatenate(part), (0.1, 0.9)) for part in (drawn, photographed))
    return float(min(np.ptp(pair) for pair in quantiles))


def _split_by_distance(capture: Capture, pictures: Sequence[Picture]) -> tuple[float | None, float | None]:
    """Return the average PSNR of the held-out views near to, and far from, their nearest training view."""
    if not capture.scene.train or len(pictures) < 2:
        return None, None
    centers = np.stack([camera.center for camera in capture.scene.train])
    distance = [np.linalg.norm(centers - picture.view.camera.center, axis=1).min() for picture in pictures]
    order = np.argsort(distance, kind="stable")
    values = np.array([min(picture.psnr or 0.0, 100.0) for picture in pictures])[order]
    half = len(order) // 2
    return float(values[:half].mean()), float(values[half:].mean())


def raise_flags(
    evidence: Evidence,
    pose: Pose,
    asset: Asset,
    capture: Capture,
    covered: float,
    mask: float | None,
    invalid_faces: int,
) -> list[Flag]:
    """Return the flags of an asset; `covered` is its share of all pixels, and `mask` of the masks' pixels."""
    flags = []

    def check(code: str, *, is_raised: bool, sentence: str) -> None:
        if is_raised:
            flags.append(Flag(code, sentence))

    low = covered < MIN_COVERED if mask is None else mask < MIN_MASK
    share = f"{100 * covered:.0f} % of the pixels" if mask is None else f"{100 * mask:.0f} % of the mask"
    check("LOW_COVERAGE", is_raised=low, sentence=f"it covers {share}")
    parallax = evidence.parallax
    text = f"its surface explains the motion between photographs of {100 * (parallax or 0):.0f} % of "
    check(
        "NO_PARALLAX",
        is_raised=parallax is not None and parallax < MIN_PARALLAX,
        sentence=f"{text}{evidence.parallax_matches:,} points",
    )
    is_off = pose.source != "found" and evidence.aligned is not None and evidence.aligned < MIN_ALIGNED
    text = "its drawings do not match the photographs; use --pose found"
    check("MISALIGNED", is_raised=is_off, sentence=text)
    single, behind = evidence.single_view or 0.0, evidence.behind or 0.0
    text = f"{100 * single:.0f} % of its visible surface is visible in one photograph only"
    check("SINGLE_VIEW_FACES", is_raised=single > MAX_SINGLE_VIEW, sentence=text)
    text = "it is a mirror image of the captured thing"
    check("MIRRORED", is_raised=pose.mirrored, sentence=text)
    text = f"{100 * behind:.0f} % of its visible surface is seen from behind"
    check("INSIDE_OUT", is_raised=behind > MAX_BEHIND, sentence=text)
    flat = evidence.contrast is not None and evidence.contrast < MIN_CONTRAST
    check("NO_CONTRAST", is_raised=flat, sentence="its pixels, or the photographs', are almost uniform")
    text = f"{invalid_faces:,} faces with invalid values were left out"
    check("INVALID_VALUES", is_raised=invalid_faces > 0, sentence=text)
    # The size of the asset in its own units, and in the capture relative to the cameras.
    positions = asset.buffers["positions"]
    size = float(np.ptp(positions, axis=0).max()) if len(positions) else 0.0
    reach = max(measure_radius(capture.cameras), 1e-300)
    ratios = [pose.scale] if pose.source == "found" else [pose.scale, pose.scale * size / reach]
    extreme = any(not 1 / MAX_SCALE <= ratio <= MAX_SCALE for ratio in ratios)
    text = f"one of its units is {pose.scale:.3g} units of the capture"
    check("EXTREME_SCALE", is_raised=extreme, sentence=text)
    return flags
