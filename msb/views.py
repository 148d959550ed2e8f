"""Default views for judging a model, and the PSNR of its renderings in these views.

The default views are the training cameras of the model, if they are stored beside it. Without training
cameras, msb generates views around the model, or inside the model if it is an interior.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.base.origin import Origin
from msb.errors import DeviceError, UsageError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.metrics.images import psnr_of_mse
from msb.registry import Tier
from msb.render import Renderer
from msb.render.backend import minimal_options
from msb.render.frame import Frame
from msb.render.images import to_bytes
from msb.render.options import ViewKind
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from msb.scenes.around import find_bulk, is_surrounded, make_turntable, place_inside
from msb.scenes.framing import MIN_COVERAGE, Framing, find_framing
from msb.scenes.sets import check_cameras

# Maximum number of training cameras to use. The cameras are spread evenly over all training cameras. The
# limit bounds the computing time.
MAX_TRAINING_VIEWS = 12
# If outside views see less than this share of the area, inside views are also tried. If inside views see less
# than this share, outside views are also tried.
MIN_SEEN_SHARE = 0.8
# Number of outside views, and of inside views, that measure the visible area. The views are spread evenly.
_MEASURED_VIEWS = 12
# Number of training cameras that are checked. If less than half of these cameras see the asset, the cameras
# belong to another model in the same folder.
_CHECKED_CAMERAS = 8
# Width and height in pixels of the depth maps that distinguish an interior from an object. Small depth maps
# suffice, because only the shares of visible faces are compared.
_DEPTH_SIZE = (320, 240)
# Number of faces tested for visibility in the depth maps, spread evenly over all faces.
_TESTED_FACES = 4000
# Share of the visible faces that outside cameras see from behind. If this share is above 2/3, the winding is
# consistent and front sides point inwards. If this share is below 1/3, the winding is consistent and front
# sides point outwards. For faces with random winding, the share is 1/2.
_BEHIND_SHARE = 2 / 3
# Less strict limits of this share, which decide between inside and outside views. Measured shares are 0.3 for
# a diorama, 0.66 for a room, and 0.49 to 0.55 for captures with random winding.
_OUTWARD_SHARE, _INWARD_SHARE = 0.4, 0.6
# A face is visible if the depth of its centre is at most this factor times the depth map's value. The
# tolerance is needed because the face centre and the pixel centre differ.
_DEPTH_TOLERANCE = 1.01


@dataclass(frozen=True)
class ChosenViews:
    """Cameras for judging a model, and the origin of the cameras.

    Attributes
    ----------
    cameras : list of Camera
    origin : {"given", "training", "turntable", "inside", "both"}
        "turntable", "inside" and "both" are generated: around the model, inside the model, or half of the
        views each.
    description : str
        The origin of the cameras in words.
    place : Path, optional
        The file or folder of training cameras.
    coverage : float, optional
        The share of the pixels of these cameras that the model covers; None if it was not measured.
    """

    cameras: list[Camera]
    origin: Literal["given", "training", "turntable", "inside", "both"]
    description: str
    place: Path | None = None
    coverage: float | None = None

    @property
    def is_generated(self) -> bool:
        """Whether msb generated the views."""
        return self.origin not in ("given", "training")

    @property
    def why_not(self) -> str | None:
        """The reason why these views are unsuitable for judging the model.

        The reason is None if the views are suitable, or if `coverage` is unknown.
        """
        if not self.cameras:
            return self.blind_message
        if self.coverage is None or self.coverage >= MIN_COVERAGE:
            return None
        share = f"{100 * self.coverage:.2g} % of the pixels ({self.description})"
        text = f"the mesh covers only {share}; at least {100 * MIN_COVERAGE:g} % are required"
        return f"{text}; pass {'' if self.origin == 'given' else '--'}cameras that are closer to the mesh"

    @property
    def blind_message(self) -> str:
        """The error message for the case that no camera shows a pixel of the mesh."""
        text = f"no camera shows the mesh ({self.description})"
        if self.origin == "given":
            return f"{text}; pass cameras that see the mesh, in the coordinates of the mesh"
        return f"{text}; pass --cameras"

    def relative_to(self, origin: Origin) -> ChosenViews:
        """Return the views in coordinates relative to the origin of an asset."""
        return replace(self, cameras=[camera.relative_to(origin) for camera in self.cameras])

    def without_blind(self, asset: Asset, device: str | None = None) -> ChosenViews:
        """Return the views that see the asset on the standard or dedicated tier."""
        return self.with_covered(_measure_coverage(asset, self.cameras, device, len(self.cameras)))

    def with_covered(self, covered: Mapping[int, float] | None) -> ChosenViews:
        """Return the views that show the model, with their coverage.

        `covered` maps the number of each camera that sees the model to the share of pixels that the model
        covers. `covered` is None if the pixel shares are unknown.
        """
        if not covered:
            return self if covered is None else replace(self, cameras=[])
        cameras = [self.cameras[k] for k in sorted(covered)]
        pixels = [camera.width * camera.height for camera in cameras]
        coverage = sum(covered[k] * n for k, n in zip(sorted(covered), pixels, strict=True)) / sum(pixels)
        blind, text = len(self.cameras) - len(cameras), self.description
        text += f"; {blind} of these cameras do not show the model and are ignored" if blind else ""
        return replace(self, cameras=cameras, description=text, coverage=coverage)


def _measure_coverage(
    asset: Asset, cameras: Sequence[Camera], device: str | None, enough: int
) -> dict[int, float] | None:
    """Find the first `enough` cameras that show the asset.

    The result maps the number of each camera that sees the asset to the share of pixels that the asset
    covers. The result is None if no tier can draw the asset. Drawing the asset later raises the error.
    """
    all_tiers: tuple[Tier, ...] = ("standard", "dedicated")
    tiers = [tier for tier in all_tiers if why_not(asset.manifest, tier) is None]
    if not tiers:
        return None
    covered: dict[int, float] = {}
    try:
        for tier in tiers:
            if len(covered) == min(enough, len(cameras)):
                break
            with Renderer(asset, tier, device, **minimal_options(tier, None)) as renderer:
                for number, camera in enumerate(cameras):
                    if len(covered) < enough and number not in covered:
                        share = measure_coverage(renderer.render(camera))
                        covered |= {number: share} if share else {}
    except DeviceError:
        return None
    return covered


def measure_coverage(frame: Frame) -> float:
    """Return the share of a frame's pixels that the model covers."""
    return float(np.count_nonzero(frame.alpha > 0) / frame.alpha.size)


def choose_views(
    asset: Asset,
    given: ChosenViews | Iterable[Camera] | None = None,
    *,
    count: int = 8,
    size: tuple[int, int] = (640, 480),
    device: str | None = None,
    kind: ViewKind | None = None,
) -> ChosenViews:
    """Return the views for judging an asset: given cameras, else training cameras, else generated views.

    Parameters
    ----------
    given : iterable of Camera, optional
        Cameras of the caller, used without changes.
    count : int
        The number of generated views.
    size : (int, int)
        Width and height of generated views in pixels; training cameras are scaled to the longer side.
    kind : {"outside", "inside", "both"}, optional
        Generate views of this kind. Default: the training cameras, or else the kind of views that suits the
        asset.
    """
    if isinstance(given, ChosenViews):
        return given
    if given is not None:
        return check_given_views(given)
    framing = find_framing(asset)
    outside = make_turntable(asset, count, *size, framing=framing)
    try:
        training = None
        if kind is None:
            training = find_training_views(asset, device, most=MAX_TRAINING_VIEWS, longest=max(size))
        return training or generate_views(asset, outside, framing, device, kind=kind)
    except DeviceError:  # drawing the asset raises this error again
        return _describe_generated(outside, "turntable", framing)


def check_given_views(cameras: Iterable[Camera]) -> ChosenViews:
    """Return the cameras of a caller.

    Raises
    ------
    UsageError
        USAGE: no camera is given.
    """
    chosen = check_cameras(cameras)
    if not chosen:
        raise UsageError("USAGE", "cameras is empty; pass at least one camera, or None for default views")
    return ChosenViews(chosen, "given", f"{len(chosen)} camera{'' if len(chosen) == 1 else 's'} given")


def find_training_views(
    asset: Asset, device: str | None = None, *, most: int | None = None, longest: int | None = None
) -> ChosenViews | None:
    """Return the training cameras stored beside an asset, or None if most of them do not see the asset.

    At most `most` cameras are returned. The chosen cameras are spread evenly over all cameras. The images are
    scaled down so that no side is longer than `longest` pixels.
    """
    from msb.adapters.training_cameras import training_cameras

    if asset.opened_from is None:
        return None
    for cameras, place in training_cameras(asset.opened_from, asset.manifest.method):
        few = spread_evenly(cameras, most or len(cameras))
        if longest is not None:
            few = [camera.scaled(min(1.0, longest / max(camera.width, camera.height))) for camera in few]
        share = f"{len(few)} of {len(cameras)}" if len(few) < len(cameras) else f"{len(few)}"
        sample = spread_evenly(few, _CHECKED_CAMERAS)
        half = (len(sample) + 1) // 2
        covered = _measure_coverage(asset, sample, device, half)
        if covered is None or len(covered) == half:
            return ChosenViews(few, "training", f"{share} training cameras ({place.name})", place)
    return None


def generate_views(
    asset: Asset,
    outside: list[Camera],
    framing: Framing,
    device: str | None = None,
    up: str | None = None,
    kind: ViewKind | None = None,
) -> ChosenViews:
    """Return the views `outside`, an equal number of inside views, or both.

    If `kind` is None, inside views are used for interiors. If the chosen views see little of the area, and
    views of the other kind see more, the other views are returned. `framing` is the part of the model that
    the `outside` views show. `up` is the up axis of the inside views; the default is the asset's up axis.

    Raises
    ------
    UsageError
        USAGE: views from inside are requested, but the asset is flat.
    """
    bulk = find_bulk(asset, framing)
    within = [] if kind == "outside" else place_inside(asset, framing, bulk, outside, up)
    if kind == "inside" and not within:
        text = "views from inside are impossible, because most of the mesh is flat; use views from outside"
        raise UsageError("USAGE", text, file=asset.opened_from)
    if not within:
        chosen = _describe_generated(outside, "turntable", framing)
        text = f"{chosen.description}; no views from inside, because most of the mesh is flat"
        return replace(chosen, description=text) if kind == "both" else chosen
    if kind == "both":
        cameras = [replace(camera, name=f"{k:05d}") for k, camera in enumerate([*outside, *within])]
        return _describe_generated(cameras, "both", framing)
    if kind == "inside":
        return _describe_generated(within, "inside", framing)
    why = ""
    is_capture = is_surrounded(bulk)
    if is_capture:
        why = "large faces surround most of the model"
    elif _is_interior(asset, outside, within, device):
        why = "most faces are hidden from outside or visible from behind"
    # Use the other kind of views if the chosen views see little of the area and the other views see more.
    from_inside = bool(why)
    seen_outside, seen_within, behind = _measure_seen_areas(asset, outside, within, device)
    seen, other = (seen_within, seen_outside) if from_inside else (seen_outside, seen_within)
    # Walls around a capture are visible from both sides, unless all wall faces point outwards.
    can_change = behind <= _OUTWARD_SHARE or not is_capture
    if seen < MIN_SEEN_SHARE and other > seen and can_change:
        here, there = ("inside", "outside") if from_inside else ("outside", "inside")
        why = f"these views show {100 * other:.0f} % of its area; views from {here} show {100 * seen:.0f} %"
        from_inside = there == "inside"
    if from_inside:
        return _describe_generated(within, "inside", framing, why)
    return _describe_generated(outside, "turntable", framing, why)


def _describe_generated(
    cameras: list[Camera],
    origin: Literal["turntable", "inside", "both"],
    framing: Framing,
    why: str = "",
) -> ChosenViews:
    """Return generated views with their description. `why` is the reason for an unusual choice of views."""
    place = {"turntable": "around the model", "inside": "from inside", "both": "around and inside the model"}
    text = f"{len(cameras)} generated views {place[origin]}"
    text += f", because {why}; pass --cameras for other views" if why else ""
    return ChosenViews(cameras, origin, text + framing.note)


def _measure_seen_areas(
    asset: Asset, outside: list[Camera], within: list[Camera], device: str | None
) -> tuple[float, float, float]:
    """Return the shares of the area visible from outside and from inside, and the winding.

    The winding is the share of visible faces that outside cameras see from behind. If the winding is
    consistent, only front sides count as visible. If no renderer can measure the visible areas, the function
    returns 1 for both shares.
    """
    if why_not(asset.manifest, "standard") is not None:
        return 1.0, 1.0, 0.5
    with Renderer(asset, "standard", device) as renderer:
        (front, back, behind, area), (front_within, back_within, *_) = (
            _test_visibility(asset, renderer, spread_evenly(cameras, _MEASURED_VIEWS))
            for cameras in (outside, within)
        )
    if _OUTWARD_SHARE < behind < _INWARD_SHARE:
        front, front_within = front | back, front_within | back_within
    total = max(area.sum(), np.finfo(np.float64).tiny)
    return float(area[front].sum() / total), float(area[front_within].sum() / total), behind


def spread_evenly(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return `count` cameras, spread evenly and beginning with the first.

    If there are fewer cameras, all cameras are returned.
    """
    if len(cameras) <= count:
        return list(cameras)
    return [cameras[k * len(cameras) // count] for k in range(count)]


def _is_interior(asset: Asset, outside: list[Camera], within: list[Camera], device: str | None) -> bool:
    """Return whether outside cameras see less than half of the faces, and inside cameras see more.

    Visibility is tested only at face centres, so that the size of a face has no influence.
    """
    if why_not(asset.manifest, "standard") is not None:
        return False
    with Renderer(asset, "standard", device) as renderer:
        front, back, behind, _ = _test_visibility(asset, renderer, outside)
        # If the winding is consistent, only front sides count as visible. If the winding is not consistent,
        # back sides also count as visible.
        is_sided = behind >= _BEHIND_SHARE or behind <= 1 - _BEHIND_SHARE
        visible = (front if is_sided else front | back).mean()
        if visible >= 0.5:
            return False
        front, back, *_ = _test_visibility(asset, renderer, within)
        return bool((front if is_sided else front | back).mean() > visible)


def _test_visibility(
    asset: Asset, renderer: Renderer, cameras: list[Camera]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], float, NDArray[np.float64]]:
    """Test the visibility of a sample of n faces.

    The first two results are masks (n,) of the faces that are visible from the front and from behind. The
    third result is the share of the visible faces that cameras see from behind. The last result contains
    weights (n,) proportional to the area of each face.
    """
    # Compute centres (n, 3) and normals (n, 3) of an evenly spread sample of the faces.
    faces = asset.buffers["indices"]
    corners = asset.buffers["positions"][faces[:: max(1, len(faces) // _TESTED_FACES)]].astype(np.float64)
    corners += asset.manifest.origin
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front, back = np.zeros((2, len(middle)), bool)
    sides = [0, 0]
    for camera in (view.resized(*_DEPTH_SIZE) for view in cameras):
        # A face centre is visible if its depth z agrees with the depth map at its pixel.
        depth = renderer.render(camera).depth
        pixels, z = camera.project(middle)
        column, row = np.floor(np.nan_to_num(pixels, nan=-1.0)).T
        is_inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        row, column = (np.where(is_inside, index, 0).astype(int) for index in (row, column))
        surface = np.where(is_inside, depth[row, column], 0)
        is_visible = (surface > 0) & (z <= _DEPTH_TOLERANCE * surface)
        is_facing = (normal * (camera.center - middle)).sum(axis=1) > 0
        front |= is_visible & is_facing
        back |= is_visible & ~is_facing
        sides = [
            sides[0] + int((is_visible & is_facing).sum()),
            sides[1] + int((is_visible & ~is_facing).sum()),
        ]
    return front, back, sides[1] / max(1, sum(sides)), np.linalg.norm(normal, axis=1)


def render_standard(
    mesh: Mesh,
    cameras: Iterable[Camera],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    device: str | None = None,
    supersample: int = 1,
) -> list[NDArray[np.float32]]:
    """Return the standard-tier images (H, W, 3) of a mesh."""
    asset = asset_from_mesh(mesh)
    with contextlib.closing(StandardRenderer(asset, device=device, supersample=supersample)) as renderer:
        views = (camera.in_units(asset.manifest.origin) for camera in cameras)
        return [renderer.render_image(view, background) for view in views]


def squared_errors(images: Sequence[Any], references: Sequence[Any]) -> NDArray[np.float64]:
    """Return the sum of squared differences and the number of values for each view, as an array (n, 2).

    A view is an image or a `Frame`. Differences between colours are in 8-bit levels, from 0 to 255.
    """
    sums = []
    for pair in zip(images, references, strict=True):
        levels = [to_bytes(np.asarray(getattr(view, "image", view))) for view in pair]
        change = np.subtract(*levels, dtype=np.int32)
        # Do not use a matrix product: the threads of BLAS keep running and slow down the OpenCL kernels.
        sums.append((np.square(change, out=change).sum(dtype=np.int64), change.size))
    return np.array(sums, np.float64)


def psnr_over_views(images: Sequence[Any], references: Sequence[Any]) -> float:
    """Return the PSNR in dB over the pixels of all views.

    The function does not average the PSNR of single views, because the PSNR of two equal images is infinite.
    """
    return pooled_psnr(squared_errors(images, references))


def pooled_psnr(errors: NDArray[np.float64]) -> float:
    """Return the PSNR in dB over all views, from the result of `squared_errors`."""
    squares, count = errors.sum(axis=0)
    return psnr_of_mse(squares / (255**2 * count))
