"""The views of a bake: those that teach, those that judge its choices, and those held back for its numbers.

The three never overlap. What is held back is drawn only when everything is made.
"""

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from msb.asset import Asset
from msb.asset.look import up_axis
from msb.asset.tiers import why_not
from msb.errors import MetricError, UsageError
from msb.scenes import Camera
from msb.scenes.around import around
from msb.scenes.colors import Color, check_background
from msb.scenes.datasets import (
    Scene,
    own_background,
    scene_of,
    stated_background,
    trained_otherwise,
)
from msb.scenes.sets import split_every_8th
from msb.scenes.walk import between
from msb.views import Views, given_views, made_views, training_views

# (degrees above the horizon, number of views), if there are no cameras.
RINGS = ((15.0, 18), (40.0, 14), (65.0, 8))
BELOW = (-35.0, 12)  # the same for views of a plain mesh from below
_MADE_SIZE = 480, 360
MOST_PIXELS = 1 << 20  # pixels of a training image; larger cameras are scaled
_FEWEST_TO_SPARE = 3  # supervising views from which on some are kept for validation
_ENOUGH = 40  # supervising views; fewer are completed by interpolated views
_MOST_BETWEEN = 8  # interpolated views per view after the first; two views alone have little between them


@dataclass(frozen=True)
class BakeViews:
    """The views of a bake.

    Attributes
    ----------
    teaching, aside, held_back : tuple of Camera
        Those that teach; those of them that are kept aside to judge choices by; those that are for the
        numbers alone. There are none of the last where there is one view, and none of the second where fewer
        than three are left.
    between : tuple of Camera
        Views between those of the first two, which teach as well where these are few: of triangles that a
        handful of pictures moved, other views see what nobody wanted.
    origin : {"scene", "given", "training", "turntable", "inside"}
        Where they are from; the last two are made here.
    said : str
        The same in words.
    background : (float, float, float)
        The colour behind the model.
    scene : Scene, optional
        The scene that they are of.
    notes : tuple of str
        What else should be known of them.
    """

    teaching: tuple[Camera, ...]
    aside: tuple[Camera, ...]
    held_back: tuple[Camera, ...]
    between: tuple[Camera, ...]
    origin: str
    said: str
    background: Color
    scene: Scene | None = None
    notes: tuple[str, ...] = ()

    @property
    def taught(self) -> tuple[Camera, ...]:
        """All that any choice is made by."""
        return (*self.teaching, *self.between, *self.aside)


def bake_views(
    asset: Asset,
    scene: Scene | str | os.PathLike[str] | None = None,
    cameras: Iterable[Camera] | None = None,
    *,
    up: str | None = None,
    background: Sequence[float] | str | None = None,
    photographs: bool = False,
    device: str | None = None,
) -> BakeViews:
    """Return the views of a bake: of a scene, else the cameras given, else of its training, else made ones.

    Parameters
    ----------
    scene : Scene or path-like, optional
        Its training views teach, its test views are held back.
    cameras : iterable of Camera, optional
        Every 8th is held back, as of those of a training and of made ones.
    up : str, optional
        The axis, such as "+z", round which views are made; that of the asset if not given.
    background : (3,) floats, or str, optional
        As for `msb.render`; that of the scene, else the asset's own.
    photographs : bool
        Whether they must have a photograph.

    Raises
    ------
    MetricError
        METRIC_NOTHING_SHOWN: no view sees the asset.
    UsageError, SceneError
        No camera, both a scene and cameras, or no such scene.
    """
    if scene is not None and cameras is not None:
        raise UsageError("USAGE", "cameras and a scene are given; give one of them")
    if scene is not None:
        return _of_scene(asset, scene, background, photographs, device)
    notes: list[str] = []
    if cameras is not None:
        found = given_views(cameras)
    else:
        found = training_views(asset, device) or _made(asset, up, notes, device)
    found = _that_see(asset, found, device)
    views = _smaller(found.cameras, notes)
    taught, held_back = split_every_8th(views)
    if not taught:  # there is one view
        taught, held_back = held_back, []
    stated = asset.manifest.appearance.get("background")
    color = own_background(asset.manifest) if background is None else check_background(background, stated)
    return _parted(taught, held_back, found.origin, found.said, color, None, notes)


def _of_scene(
    asset: Asset,
    scene: Scene | str | os.PathLike[str],
    background: Sequence[float] | str | None,
    photographs: bool,
    device: str | None,
) -> BakeViews:
    manifest = asset.manifest
    if not isinstance(scene, Scene):
        scene = scene_of(manifest, scene)
    notes = [warning.message for warning in scene.warnings]
    if background is not None:
        scene = replace(scene, background=check_background(background, manifest.appearance.get("background")))
    notes += [
        found.message for found in trained_otherwise(manifest.training, stated_background(manifest), scene)
    ]
    train = list(scene.train)
    if photographs:
        train = [one for one in train if one.image_path is not None and Path(one.image_path).is_file()]
    if not train:
        lacks = "photographs of its training views" if photographs else "training views"
        raise UsageError("USAGE", f"it has no {lacks}, by which alone a bake is taught", file=scene.root)
    found = Views(train, "given", f"{len(train)} training views of {scene.name}")
    found = _that_see(asset, found, device)
    taught = _smaller(found.cameras, notes)
    return _parted(taught, list(scene.test), "scene", found.said, scene.background, scene, notes, photographs)


def _made(asset: Asset, up: str | None, notes: list[str], device: str | None) -> Views:
    """Return views round an asset or within it at three heights; note what is taken for up."""
    # What no training saw is arbitrary: a trained model is not looked at from below. Of a mesh all sides do.
    rings = RINGS if why_not(asset.manifest, "dedicated") is None else (*RINGS, BELOW)
    cameras = [
        camera for degrees, count in rings for camera in around(asset, count, *_MADE_SIZE, up, degrees)
    ]
    outside = [replace(camera, name=f"{number:05d}") for number, camera in enumerate(cameras)]
    if up is None and asset.manifest.coordinate_frame.known_up is None:
        notes.append(f"what is up is not recorded: {up_axis(asset)} is taken for it; --up names another axis")
    found = made_views(asset, outside, device, up)
    return replace(found, said=f"{found.said}, {up or up_axis(asset)} up")


def _that_see(asset: Asset, views: Views, device: str | None) -> Views:
    """Return the views that see something of the asset; refuse a set of which none does."""
    seeing = views.seeing(asset, device)
    if not seeing.cameras:
        raise MetricError("METRIC_NOTHING_SHOWN", seeing.nothing, file=asset.opened_from)
    return seeing


def _smaller(cameras: Sequence[Camera], notes: list[str]) -> list[Camera]:
    """Return the cameras, those of too many pixels scaled; note how many that are."""
    scale = [min(1.0, math.sqrt(MOST_PIXELS / (one.width * one.height))) for one in cameras]
    made = [one.scaled(factor) if factor < 1 else one for one, factor in zip(cameras, scale, strict=True)]
    large = [(one, new) for one, new in zip(cameras, made, strict=True) if one is not new]
    if large:
        old, new = large[0]
        sizes = f"from {old.width} x {old.height} to {new.width} x {new.height}"
        notes.append(f"{len(large)} of {len(cameras)} views teach scaled, such as {sizes} pixels")
    return made


def _parted(
    taught: list[Camera],
    held_back: list[Camera],
    origin: str,
    said: str,
    background: Color,
    scene: Scene | None,
    notes: list[str],
    photographs: bool = False,
) -> BakeViews:
    teaching, aside = split_every_8th(taught) if len(taught) >= _FEWEST_TO_SPARE else (taught, [])
    more: list[Camera] = []
    if not photographs:  # there is none of where nobody stood
        more = between(taught, min(_ENOUGH - len(taught), _MOST_BETWEEN * (len(taught) - 1)))
    return BakeViews(
        tuple(teaching),
        tuple(aside),
        tuple(held_back),
        tuple(more),
        origin,
        said,
        background,
        scene,
        tuple(notes),
    )
