"""Command-line options for cameras, image sizes, backgrounds and renderers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msb.base.option import Argument, Option
from msb.base.paths import normal_form
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

Source = Annotated[Path, Argument("A .triasset, checkpoint or mesh file.", metavar="ASSET")]
Up = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
# An axis such as "+z", or a direction "X,Y,Z".
UpDirection = str
# Placement of mesh files, for commands that write mesh files.
Scale = Annotated[
    float | None,
    Option("Length of the scene's unit in metres. Mesh files are then written in metres.", metavar="X"),
]
KnownDistance = Annotated[
    tuple[str, str, str] | None,
    Option(
        "Two points of the scene and the distance between them, such as 0,0,0 0,0,1 1.2m. Replaces --scale.",
        metavar="X,Y,Z X,Y,Z LENGTH",
    ),
]
Floor = Annotated[bool, Option("Put the lowest visible point of the mesh at height 0 in mesh files.")]
# Placement of generated views.
ViewKind = Literal["outside", "inside", "both"]
NO_CAMERAS = "needs --cameras PATH"
ONLY_GENERATED = "applies only to generated views, without --cameras"
# Maximum width or height of an image in pixels: the limit of common OpenGL drivers.
MOST_PIXELS = 16384
Split = Literal["train", "test", "all"]
Tier = Literal["reference", "dedicated", "standard"]


@dataclass(frozen=True)
class ViewOptions:
    """The cameras and the background of the images."""

    cameras: Annotated[
        Path | None,
        Option("COLMAP folder, transforms_*.json, cameras.json, views.json.", metavar="PATH"),
    ] = None
    camera: Annotated[
        tuple[str, ...],
        Option("Draw only this camera; can be repeated. Default: all cameras.", metavar="NAME|INDEX|all"),
    ] = ()
    size: Annotated[
        str | None,
        Option(
            "Size of the images in pixels, or a factor for the size of the cameras.",
            ("--size", "--scale"),
            metavar="WxH|FACTOR",
        ),
    ] = None
    background: Annotated[
        str | None,
        Option(
            "black, white, #rrggbb, r,g,b in 0..1, or official. Default: official, the background that the "
            "asset records; otherwise the background of its method, or black.",
            metavar="COLOR",
        ),
    ] = None
    kind: Annotated[
        ViewKind | None,
        Option(
            "Without --cameras: generate views around the model, inside it, or both. Default: the training "
            "cameras, otherwise the views that show more of the model.",
            ("--views",),
        ),
    ] = None

    def read(self, note: Callable[[str], None]) -> list[Camera]:
        """Return the requested cameras; call `note` if their images are far larger than the photographs."""
        from msb.scenes import read_cameras
        from msb.scenes.datasets import note_recorded_size

        cameras = read_cameras(str(self.cameras))
        models = sorted({camera.distortion.model for camera in cameras if camera.distortion is not None})
        if models:
            left_out = f"lens distortion ({', '.join(models)}) is ignored; images use the pinhole part"
            note(f"{self.cameras}: {left_out}")
        if self.size is None and (text := note_recorded_size(str(self.cameras), cameras)) is not None:
            note(f"{self.cameras}: {text}")
        return self.of(cameras)

    def of(self, cameras: list[Camera]) -> list[Camera]:
        """Return the requested cameras among `cameras`, resized if --size was given."""
        everything = not self.camera or "all" in self.camera
        chosen = cameras if everything else [_find(cameras, name) for name in self.camera]
        if self.size is None:
            return chosen
        if (size := self._sides) is not None:
            return [camera.resized(*size) for camera in chosen]
        return [camera.scaled(self._factor) for camera in chosen]

    def of_scene(self, scene: Scene) -> tuple[Split, list[Camera]]:
        """Return the split and the requested cameras of a scene; the default is the test views.

        ``train`` selects the training views, ``all`` the training and then the test views. Camera numbers
        count the test views first, then the training views.
        """
        train, test = list(scene.train), list(scene.test)
        words = set(self.camera)
        if words <= {"train", "test", "all"}:
            split: Split = "test" if words <= {"test"} else "train" if words == {"train"} else "all"
            return split, {"train": train, "test": test, "all": [*train, *test]}[split]
        cameras = self.of([*test, *train])
        known = {camera.name for camera in test}
        return ("test" if all(camera.name in known for camera in cameras) else "all"), cameras

    def pixels(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of images without cameras: --size, else `width` x `height` pixels."""
        if self.size is None:
            return width, height
        if (size := self._sides) is not None:
            return size
        return max(1, round(width * self._factor)), max(1, round(height * self._factor))

    @property
    def _sides(self) -> tuple[int, int] | None:
        """The requested width and height in pixels, or None if --size is a factor."""
        from msb.scenes.checks import MAX_SIDE

        size = parse_size(str(self.size))
        if size is not None and max(size) > MAX_SIDE:
            text = f"--size is {size[0]}x{size[1]}; width and height must be from 1 to {MAX_SIDE} pixels"
            raise UsageError("USAGE", text)
        return size

    @property
    def _factor(self) -> float:
        try:
            factor = float(str(self.size))
        except ValueError:
            raise not_a_size(str(self.size), ", or as a factor such as 0.5") from None
        check_factor(factor)
        return factor

    def color(self, asset: Asset | None) -> tuple[float, float, float]:
        """Return the requested background; the default is the asset's background, the method's background, or
        black.
        """
        from msb.scenes.colors import BLACK
        from msb.scenes.datasets import default_background

        if self.background is None:
            return BLACK if asset is None else default_background(asset.manifest)
        official = "official needs an asset"
        if asset is not None:
            official = str(asset.manifest.appearance.get("background", "the asset records none"))
        return parse_color_option(self.background, official)


@dataclass(frozen=True)
class SceneOptions:
    """Options that define how the scene of --scene is read."""

    dataset: Annotated[
        str | None,
        Option(
            "mipnerf360, tanksandtemples, nerf_synthetic, dtu, or another name for other captures. "
            "Default: recognised by folders and photographs.",
            metavar="NAME",
        ),
    ] = None
    image_folder: Annotated[
        str | None, Option("Folder of the scene's photographs, for example images_2.", metavar="NAME")
    ] = None
    resolution: Annotated[
        int | None,
        Option(
            "1, 2, 4, 8: divide the image size by this number; -1: keep the size; other values: width in "
            "pixels.",
            ("--resolution", "-r"),
        ),
    ] = None
    camera_convention: Annotated[
        Literal["gs_fov", "full_K"] | None,
        Option(
            "full_K: recorded principal point; gs_fov: principal point in the middle of the image. "
            "Default: the mode of the method's training."
        ),
    ] = None

    @property
    def given(self) -> dict[str, Any]:
        """The given options as arguments of `scene_of`."""
        return {key: value for key, value in vars(self).items() if value is not None}

    def read(self, asset: Asset, path: Path, note: Callable[[str], None]) -> Scene:
        """Return a scene with the settings of `msb run` for the asset. Call `note` with each warning of the
        scene."""
        from msb.scenes.datasets import note_scaled_cameras, scene_of

        scene = scene_of(asset.manifest, path, **self.given)
        for warning in scene.warnings:
            note(warning.to_line(warning.file or path))
        if (text := note_scaled_cameras([scene])) is not None:
            note(f"{path}: {text}")
        return scene


# Names of the options that need a scene.
SCENE_OPTIONS = tuple(SceneOptions.__dataclass_fields__)
NO_SCENE = "needs --scene DIR"


@dataclass(frozen=True)
class RendererOptions:
    """The renderer, its options, and overrides of the asset's settings."""

    assignments: Annotated[
        tuple[str, ...],
        Option("Override a setting; msb methods lists the settings.", ("--set",), metavar="NAME=VALUE"),
    ] = ()
    supersample: Annotated[
        int, Option("Samples along each side of a pixel (standard tier).", least=1, most=16)
    ] = 1
    order: Annotated[
        Literal["tile", "global", "none"] | None,
        Option("Order of blending (dedicated tier): by official tiles, by depth only, or as stored."),
    ] = None
    sampling: Annotated[
        Literal["official", "engine"] | None,
        Option("Sample as in the official code, or as in graphics hardware (dedicated tier)."),
    ] = None
    renderer: Annotated[
        str | None, Option("Use this renderer; msb devices lists all. Default: built-in.", metavar="NAME")
    ] = None
    device: Annotated[
        str | None,
        Option(
            "OpenCL device; msb devices lists the devices. Default: MSB_DEVICE, PYOPENCL_CTX, or PoCL. "
            "Other engines (wgpu, three.js, Blender) accept cpu or gpu.",
            metavar="cpu|gpu|PLATFORM:INDEX",
        ),
    ] = None

    def settings(self, asset: Asset) -> dict[str, Any]:
        """Return the overrides of the asset's settings."""
        from msb.asset.settings import parse_overrides

        return dict(parse_overrides(asset.manifest.method, self.assignments))

    def check_device(self) -> None:
        """Raise an error if the requested device does not exist, even if nothing will be rendered."""
        if self.device is not None:
            from msb.cl.devices import choose_device

            choose_device(self.device)

    @property
    def modes(self) -> dict[str, str]:
        """The values of --order and --sampling that differ from the defaults.

        Default values are omitted, because some renderers have no such options.
        """
        modes = {"order": self.order, "sampling": self.sampling}
        return {name: value for name, value in modes.items() if value is not None}


def parse_color_option(text: str, official: str | None = None) -> tuple[float, float, float]:
    """Return the colour of --background. For the text "official", return the colour `official`.

    If `official` is not a colour, it is the reason why the asset has no official background.
    """
    from msb.scenes.colors import parse_color

    color = parse_color(text, official)
    if color is None:
        more = "" if official is None else ", or official"
        why = f" ({shorten(official, 40)})" if official and text.strip().lower() == "official" else ""
        allowed = f"black, white, #rrggbb{', ' if more else ' or '}r,g,b in 0..1{more}"
        raise UsageError("USAGE", f'--background is "{shorten(text, 40)}"{why}; use {allowed}')
    return color


def _find(cameras: list[Camera], name: str) -> Camera:
    """Return the camera with this name, otherwise the camera with this number."""
    named = [(camera, normal_form(camera.name)) for camera in cameras if camera.name]
    wanted = normal_form(name)
    matches = [camera for camera, known in named if known == wanted]
    matches = matches or [camera for camera, known in named if _stem(known) == wanted]
    if len(matches) > 1:
        names = ", ".join(str(camera.name) for camera in matches[:4])
        raise UsageError("NAME_UNKNOWN", f'"{shorten(name, 40)}" matches several cameras: {names}')
    if matches:
        return matches[0]
    if re.fullmatch(r"\d{1,9}", name) and int(name) < len(cameras):
        return cameras[int(name)]
    names = ", ".join(shorten(str(camera.name), 30) for camera in cameras[:4])
    text = f'camera "{shorten(name, 40)}" does not exist; the {len(cameras)} cameras are {names}'
    text += ", ..." if len(cameras) > 4 else ""
    raise UsageError("NAME_UNKNOWN", text)


def _stem(name: str) -> str:
    return name.rsplit("/", 1)[-1].rsplit(".", 1)[0]


def parse_size(text: str) -> tuple[int, int] | None:
    """Return width and height in pixels of a text like 1237x822, or None for any other text."""
    match = re.fullmatch(r"\s*([1-9]\d{0,5})[x,]([1-9]\d{0,5})\s*", text, re.IGNORECASE)
    return None if match is None else (int(match[1]), int(match[2]))


def check_factor(factor: float) -> None:
    """Raise an error if a scale factor for image sizes is out of range."""
    if not 0 < factor <= MOST_PIXELS:
        text = f"--scale is {factor:g}; the factor must be above 0 and at most {MOST_PIXELS}"
        raise UsageError("USAGE", text)


def not_a_size(text: str, more: str = "") -> UsageError:
    """Return the error for an invalid --size; `more` lists further accepted forms."""
    return UsageError("USAGE", f'--size is "{shorten(text, 40)}"; write it as 1237x822{more}')
