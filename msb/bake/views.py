"""The views of a bake: disjoint sets of training, validation and test (held-out) views.

Test views are rendered last and are only used for the final measurement.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from msb.asset import Asset
from msb.asset.look import up_axis
from msb.asset.tiers import why_not
from msb.base.origin import Origin
from msb.errors import MetricError, UsageError
from msb.render.options import ViewKind
from msb.scenes import Camera
from msb.scenes.around import make_rings, make_turntable
from msb.scenes.colors import Color, check_background
from msb.scenes.datasets import Scene, compare_training, default_background, scene_of, stated_background
from msb.scenes.framing import find_framing
from msb.scenes.sets import split_every_8th
from msb.scenes.walk import fill_gaps
from msb.views import ChosenViews, check_given_views, find_training_views, generate_views

# Each pair describes a ring of generated views: the angle above the horizon in degrees, and the number of
# views. The rings have 40 views in all.
RINGS = ((15.0, 18), (40.0, 14), (65.0, 8))
# Rings of views from below the horizon. Views from below are only generated for mesh files. Training cameras
# rarely look up from below, so the underside of a trained model is arbitrary.
RING_BELOW = (-35.0, 12)
# Rings of generated views for Gaussians, 48 views in all. One ring is below the horizon, because captures of
# objects also contain such views. The model fills each of these generated views.
SPLAT_RINGS = ((5.0, 16), (25.0, 14), (50.0, 10), (-12.0, 8))
_SPLAT_PIXELS = 384 * 768
# Background colours of generated views, for Gaussians without a recorded background.
_GREYS: tuple[Color, Color] = ((0.3, 0.3, 0.3), (0.7, 0.7, 0.7))
# Width and height of generated views in pixels.
_GENERATED_SIZE = 480, 360
# Number of pixels of the largest view. Larger views are scaled down to limit the time of a bake.
MAX_PIXELS = 1 << 20
# If there are fewer views than this, all views are training views, and there are no validation views.
_MIN_VIEWS_TO_SPLIT = 3
# If there are fewer views than this, interpolated views are added. With few views, optimised triangles cause
# artefacts of up to 6 dB in other views.
_ENOUGH_VIEWS = 40
# Largest number of interpolated views per training view. The first training view is not counted. Between few
# views, only a few interpolated views are useful.
_MAX_INTERPOLATED = 8


@dataclass(frozen=True)
class BakeViews:
    """The views of a bake: training, validation and test views with their background colours.

    Attributes
    ----------
    training, validation, test : tuple of Camera
        Training views supervise the fit. Validation views are taken from the training views and decide
        between results. Test views are held out for the final measurement. A single view is a training view.
        With fewer than three training views, there is no validation view.
    interpolated : tuple of Camera
        Additional training views between the other views. Views are only added if there are few views.
    origin : {"scene", "given", "training", "turntable", "inside", "both"}
        Where the views come from. "training": cameras found in the folder of the model.
    description : str
        The origin in words.
    background : (float, float, float)
        The background colour.
    backgrounds : dict of str to (float, float, float)
        Camera name -> background colour, for views with a different background.
    scene : Scene, optional
        The scene of the views.
    notes : tuple of str
        Notes for the user.
    is_generated : bool
        Whether the views are generated.
    why_not_judged : str, optional
        The reason why quality was not measured: the model covers too few pixels.
    """

    training: tuple[Camera, ...]
    validation: tuple[Camera, ...]
    test: tuple[Camera, ...]
    interpolated: tuple[Camera, ...]
    origin: str
    description: str
    background: Color
    scene: Scene | None = None
    notes: tuple[str, ...] = ()
    is_generated: bool = False
    why_not_judged: str | None = None
    backgrounds: dict[str, Color] = field(default_factory=dict)

    def background_of(self, camera: Camera) -> Color:
        """Return the background colour of a view. The camera of the view may be scaled."""
        return self.backgrounds.get(str(camera.name), self.background)

    def relative_to(self, origin: Origin) -> BakeViews:
        """Return the views in coordinates relative to the origin of a model. `scene` is not changed."""
        kinds = ("training", "validation", "test", "interpolated")
        moved: dict[str, Any] = {
            kind: tuple(camera.relative_to(origin) for camera in getattr(self, kind)) for kind in kinds
        }
        return replace(self, **moved)

    @property
    def all_but_test(self) -> tuple[Camera, ...]:
        """Training, interpolated and validation views, in this order."""
        return (*self.training, *self.interpolated, *self.validation)


def choose_bake_views(
    asset: Asset,
    scene: Scene | str | os.PathLike[str] | None = None,
    cameras: Iterable[Camera] | None = None,
    *,
    up: str | None = None,
    background: Sequence[float] | str | None = None,
    photographs: bool = False,
    device: str | None = None,
    kind: ViewKind | None = None,
) -> BakeViews:
    """Return the views of a bake.

    The views come from the first available source: a scene, given cameras, training cameras, or generated
    views.

    Parameters
    ----------
    scene : Scene or path-like, optional
        The training views of the scene supervise. The test views are held out.
    cameras : iterable of Camera, optional
        Every 8th camera is held out. If the views are training cameras or generated views, every 8th view is
        held out as well.
    up : str, optional
        The up axis of generated views, such as "+z". Default: the up axis of the asset.
    background : (3,) floats, or str, optional
        As for `msb.render`. Default: the scene's background, else the asset's.
    photographs : bool
        Whether each training view must have a photograph.
    kind : {"outside", "inside", "both"}, optional
        Generate these views, even if training cameras lie beside the model.

    Raises
    ------
    MetricError
        METRIC_NOTHING_SHOWN: no view sees the asset.
    UsageError, SceneError
        `cameras` is empty, a scene and cameras are both given, or the scene is invalid.
    """
    if scene is not None and cameras is not None:
        raise UsageError("USAGE", "cameras and a scene are both given; pass only one of them")
    if kind is not None and (scene is not None or cameras is not None):
        raise UsageError("USAGE", "views applies only to generated views, not with cameras or a scene")
    if scene is not None:
        return _choose_scene_views(asset, scene, background, photographs, device)
    notes: list[str] = []
    if cameras is not None:
        chosen = check_given_views(cameras)
    else:
        training_views = find_training_views(asset, device) if kind is None else None
        chosen = training_views or _generate_views(asset, up, notes, device, kind)
    chosen = _drop_blind_views(asset, chosen, device)
    views = _limit_size(chosen.cameras, notes)
    training, test = split_every_8th(views)
    if not training:  # there is only one view
        training, test = test, []
    manifest = asset.manifest
    stated = manifest.appearance.get("background")
    color = default_background(asset.manifest) if background is None else check_background(background, stated)
    split = _split(chosen, training, test, color, None, notes)
    if chosen.is_generated and background is None and stated is None and manifest.primitive == "gaussian":
        return _with_two_backgrounds(split)
    return split


def _with_two_backgrounds(views: BakeViews) -> BakeViews:
    """Alternate between two grey backgrounds, so that the outline of any model is visible."""
    groups = (views.all_but_test, views.test)
    colors = {
        str(camera.name): _GREYS[number % 2] for cameras in groups for number, camera in enumerate(cameras)
    }
    return replace(views, background=_GREYS[0], backgrounds=colors)


def _choose_scene_views(
    asset: Asset,
    scene: Scene | str | os.PathLike[str],
    background: Sequence[float] | str | None,
    photographs: bool,
    device: str | None,
) -> BakeViews:
    """Return the views of a bake with the scene's split into training and test views.

    With `photographs`, training views without a photograph are omitted.
    """
    manifest = asset.manifest
    if not isinstance(scene, Scene):
        scene = scene_of(manifest, scene)
    notes = [warning.message for warning in scene.warnings]
    if background is not None:
        scene = replace(scene, background=check_background(background, manifest.appearance.get("background")))
    notes += [
        difference.message
        for difference in compare_training(manifest.training, stated_background(manifest), scene)
    ]
    cameras = list(scene.train)
    if photographs:
        cameras = [
            view for view in cameras if view.image_path is not None and Path(view.image_path).is_file()
        ]
    if not cameras:
        lacks = "photographs of its training views" if photographs else "training views"
        raise UsageError("USAGE", f"the scene has no {lacks}; a bake needs at least one", file=scene.root)
    chosen = ChosenViews(cameras, "given", f"{len(cameras)} training views of {scene.name}")
    chosen = _drop_blind_views(asset, chosen, device)
    training, test = _limit_size(chosen.cameras, notes), list(scene.test)
    return _split(chosen, training, test, scene.background, scene, notes, interpolate=not photographs)


def _generate_views(
    asset: Asset, up: str | None, notes: list[str], device: str | None, kind: ViewKind | None
) -> ChosenViews:
    """Return generated views around an asset or inside it. Add a note if the up axis is assumed."""
    framing = find_framing(asset)
    if asset.manifest.primitive == "gaussian" and framing.box is not None:
        outside = make_rings(asset, framing, SPLAT_RINGS, _SPLAT_PIXELS, up)
        chosen = generate_views(asset, outside, framing, device, up, kind)
        return replace(chosen, description=f"{chosen.description}, {up or up_axis(asset)} up")
    rings = RINGS if why_not(asset.manifest, "dedicated") is None else (*RINGS, RING_BELOW)
    cameras = [
        camera
        for degrees, count in rings
        for camera in make_turntable(asset, count, *_GENERATED_SIZE, up, degrees, framing)
    ]
    outside = [replace(camera, name=f"{number:05d}") for number, camera in enumerate(cameras)]
    if up is None and asset.manifest.coordinate_frame.known_up is None:
        notes.append(f"the up axis is not recorded; {up_axis(asset)} is assumed. Pass --up to change it")
    chosen = generate_views(asset, outside, framing, device, up, kind)
    return replace(chosen, description=f"{chosen.description}, {up or up_axis(asset)} up")


def _drop_blind_views(asset: Asset, views: ChosenViews, device: str | None) -> ChosenViews:
    """Return the views that show the asset. Raise METRIC_NOTHING_SHOWN if no view shows it."""
    seeing = views.without_blind(asset, device)
    if not seeing.cameras:
        raise MetricError("METRIC_NOTHING_SHOWN", seeing.blind_message, file=asset.opened_from)
    return seeing


def _limit_size(cameras: Sequence[Camera], notes: list[str]) -> list[Camera]:
    """Return the cameras, scaled down to at most `MAX_PIXELS`. Add a note about scaled cameras."""
    scale = [min(1.0, math.sqrt(MAX_PIXELS / (view.width * view.height))) for view in cameras]
    scaled = [
        view.scaled(factor) if factor < 1 else view for view, factor in zip(cameras, scale, strict=True)
    ]
    large = [(view, new) for view, new in zip(cameras, scaled, strict=True) if view is not new]
    if large:
        old, new = large[0]
        sizes = f"from {old.width} x {old.height} to {new.width} x {new.height} pixels"
        notes.append(f"{len(large)} of {len(cameras)} views are scaled down, for example {sizes}")
    return scaled


def _split(
    chosen: ChosenViews,
    training: list[Camera],
    test: list[Camera],
    background: Color,
    scene: Scene | None,
    notes: list[str],
    interpolate: bool = True,
) -> BakeViews:
    """Return the views of a bake. Split off validation views and add interpolated views.

    The arguments `training` and `test` are the training and test views of `chosen`. With photographs,
    `interpolate` must be false.
    """
    count = len(training)
    fitting, validation = split_every_8th(training) if count >= _MIN_VIEWS_TO_SPLIT else (training, [])
    interpolated: list[Camera] = []
    if interpolate:
        interpolated = fill_gaps(training, min(_ENOUGH_VIEWS - count, _MAX_INTERPOLATED * (count - 1)))
    return BakeViews(
        tuple(fitting),
        tuple(validation),
        tuple(test),
        tuple(interpolated),
        chosen.origin if scene is None else "scene",
        chosen.description,
        background,
        scene,
        tuple(notes),
        chosen.is_generated,
        chosen.why_not,
    )
