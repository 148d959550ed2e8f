"""`msb render`: images of an asset from a dataset's cameras, a turntable or a camera flight."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any, Literal

from msb.base.option import Option
from msb.cli.command import Typed, command, require
from msb.cli.output import JsonOutput, Output, echo, file_option
from msb.errors import UsageError, shorten
from msb.render.options import (
    NO_SCENE,
    SCENE_OPTIONS,
    RendererOptions,
    SceneOptions,
    Source,
    Tier,
    Up,
    ViewOptions,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.render import Frame, Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

_SCENE_CONFLICT = "cannot be used with --scene, which sets the views and the image size"


@dataclass(frozen=True)
class RenderOptions:
    """What to render, and which files to write."""

    out: Annotated[
        Path | None,
        Option("Write images to this folder.", ("--out", "-o"), metavar="FOLDER", output="folder"),
    ] = None
    tier: Annotated[
        Literal["reference", "dedicated", "standard", "both"],
        Option(
            "Tier to render; msb methods describes the tiers. Pass both to render dedicated and standard."
        ),
    ] = "standard"
    scene: Annotated[
        Path | None,
        Option(
            "Render the test views of a dataset's scene, with the image size and background of msb run. "
            "--camera train or all selects other views.",
            metavar="DIR",
        ),
    ] = None
    turntable: Annotated[
        str | None,
        Option(
            "Render from N cameras around the asset, DEGREES above the horizon (default: 20).",
            metavar="N[,DEGREES]",
        ),
    ] = None
    up: Annotated[
        Up | None, Option("With --turntable: the axis that points up. Default: the up axis of the asset.")
    ] = None
    flight: Annotated[
        int | None, Option("Replace the cameras by N frames of a smooth path through the cameras.", least=1)
    ] = None
    format: Annotated[Literal["png", "npy", "exr"], Option("With --out: format of the images.")] = "png"
    name: Annotated[
        str | None,
        Option(
            "With --out: file names from {camera}, {tier}, {index}. Default: {camera} or {camera}_{tier}.",
            metavar="TEMPLATE",
        ),
    ] = None
    depth: Annotated[bool, Option("With --out: also write depths (exr with --format exr, else npy).")] = False
    ids: Annotated[bool, Option("With --out: also write face ids; -1 is the background.")] = False
    film: Annotated[Path | None, file_option("Also write a film, .mp4 or .gif.")] = None
    fps: Annotated[int, Option("With --film: frames per second.", least=1, most=240)] = 24

    @property
    def tiers(self) -> tuple[Tier, ...]:
        """The tiers to render, in order."""
        return ("dedicated", "standard") if self.tier == "both" else (self.tier,)


def _check_options(options: RenderOptions, views: ViewOptions, typed: Typed) -> None:
    """Raise an error for options that contradict each other."""
    missing = "Missing output. Pass --out FOLDER for images, --film FILE for a film, or both"
    require(options.out or options.film, missing)
    sources = views.cameras, options.scene, options.turntable
    require(any(sources), "Missing views. Pass --cameras PATH, --scene DIR or --turntable N")
    if options.out is None:
        typed.reject(["depth", "ids", "format", "name"], "needs --out FOLDER")
    if options.scene is not None:
        typed.reject(["cameras", "turntable", "flight", "size"], _SCENE_CONFLICT)
    else:
        typed.reject(SCENE_OPTIONS, NO_SCENE)
    if options.turntable is not None:
        typed.reject(["cameras", "camera", "flight"], "cannot be used with --turntable")
    else:
        typed.reject(["up"], "needs --turntable N")
    if options.film is None:
        typed.reject(["fps"], "needs --film FILE")
    if options.tier == "both":
        typed.reject(["film", "renderer"], "needs one tier, not --tier both")


@command(
    "msb render --turntable 8 -o out/turn data_stubs/splat_like.triasset",
    "msb render --turntable 12 --film out/t.mp4 data_stubs/checkpoint",
    "msb render --cameras data_stubs/views.json -o out data_stubs/checkpoint",
    "msb render --tier both --turntable 2 -o out/both data_stubs/checkpoint",
    "msb render --scene data_stubs/scenes/nerf_synthetic/pebble -o out/test \\\n"
    "      data_stubs/models/pebble/two_dts",
)
def render(
    path: Source,
    options: RenderOptions,
    reading: SceneOptions,
    views: Annotated[ViewOptions, ("cameras", "camera", "size", "background")],
    drawing: RendererOptions,
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Render an asset: images, and depths and face ids if requested.

    Each image is named after its camera. PNG stores floor(255 c + 0.5) of the clamped colour c. The formats
    npy and exr store the rendered floats unchanged. The printed hash covers the floats of all images. The
    hash is reproducible on one device with fixed versions.
    """
    from msb.api.command_files import open_asset
    from msb.render import Renderer
    from msb.render.backend import check_supported, minimal_options
    from msb.render.machine import machine

    _check_options(options, views, typed)
    asset = open_asset(path, output)
    color = views.color(asset)
    about: dict[str, Any] = {}
    if options.scene is not None:
        scene = reading.read(asset, options.scene, output.note)
        if views.background is None:
            color = scene.background
        _note_training(asset, replace(scene, background=color), path, output)
        split, cameras = views.of_scene(scene)
        about["scene"] = {
            "path": str(scene.root),
            "dataset": scene.dataset,
            "split": split,
            "image_folder": scene.image_folder,
            "camera_convention": scene.camera_convention,
        }
    else:
        cameras = _make_cameras(asset, options, views, output)
    images = _Images(options, output)
    images.check(cameras)
    settings = drawing.settings(asset)
    for tier in options.tiers:
        check_supported(asset, tier)
    documents = []
    for tier in options.tiers:
        # With --tier both, --order and --sampling apply to the dedicated tier, and --supersample to the
        # standard tier.
        alone = len(options.tiers) == 1
        modes = drawing.modes if alone or tier == "dedicated" else {}
        more = minimal_options(tier, drawing.renderer, ids=options.ids) | modes
        if drawing.supersample > 1 and (alone or tier == "standard"):
            more["supersample"] = drawing.supersample
        with Renderer(asset, tier, drawing.device, settings, name=drawing.renderer, **more) as renderer:
            rows = images.draw(renderer, cameras, color)
            documents.append(
                {
                    "schema": "msb.render/1",
                    "path": str(path),
                    "tier": tier,
                    "renderer": renderer.name,
                    **modes,
                    **about,
                    "background": list(color),
                    "machine": machine(
                        drawing.device, opencl=tier != "reference", engine=renderer.device_info
                    ),
                    "memory": dict(renderer.memory()),
                    "frames": rows,
                }
            )
    output.write_documents(documents)


def _make_cameras(asset: Asset, options: RenderOptions, views: ViewOptions, output: Output) -> list[Camera]:
    """Return the cameras of --cameras, of a camera flight, or of a turntable."""
    from msb.scenes import interpolate_cameras
    from msb.scenes.around import ELEVATION, make_turntable
    from msb.scenes.framing import find_framing
    from msb.scenes.paths import MAX_FRAMES

    if options.turntable is not None:
        match = re.fullmatch(r"(\d{1,20})(?:,(-?\d{1,2}(?:\.\d{1,6})?))?", options.turntable)
        if match is None:
            raise UsageError(
                "USAGE", f'--turntable is "{shorten(options.turntable, 40)}"; write it as 8 or 8,45'
            )
        count, degrees = int(match[1]), float(match[2] or ELEVATION)
        if not (1 <= count <= MAX_FRAMES and abs(degrees) < 90):
            text = f"1 to {MAX_FRAMES} cameras, at less than 90 degrees above or below the horizon"
            raise UsageError("USAGE", f"--turntable is {options.turntable}; allowed are {text}")
        width, height = views.pixels(960, 720)
        framing = find_framing(asset)
        if framing.left_out:
            output.note(f"{asset.opened_from}: far outliers are not framed: {framing.left_out}")
        return make_turntable(asset, count, width, height, options.up, degrees, framing)
    cameras = views.read(output.note)
    if options.flight is None:
        return cameras
    return [
        replace(camera, name=f"{index:05d}")
        for index, camera in enumerate(interpolate_cameras(cameras, options.flight))
    ]


def _note_training(asset: Asset, scene: Scene, path: Path, output: Output) -> None:
    """Print the differences between the training and the scene, except those in the warnings of the asset."""
    from msb.scenes.datasets import compare_training, stated_background

    reported = {warning.message for warning in asset.warnings}
    manifest = asset.manifest
    for finding in compare_training(manifest.training, stated_background(manifest), scene):
        if finding.message not in reported:
            output.note(finding.to_line(path))


class _Images:
    """Writes the requested files of each frame, and determines their names."""

    def __init__(self, options: RenderOptions, output: Output) -> None:
        from msb.render.images import check_film, check_format

        self.options, self.output = options, output
        self.template = options.name or ("{camera}" if len(options.tiers) == 1 else "{camera}_{tier}")
        self.planes: Literal["exr", "npy"] = "exr" if options.format == "exr" else "npy"
        self.kinds = ["image", *(["depth"] if options.depth else []), *(["ids"] if options.ids else [])]
        check_format(options.format)
        if options.film is not None:
            check_film(options.film)

    def check(self, views: list[Camera]) -> None:
        """Raise an error if files would overwrite each other or existing files. Call this check before
        rendering."""
        names = [name for tier in self.options.tiers for name in self.names(views, tier)]
        if self.options.out is not None:
            if len(set(names)) < len(names):
                lacks = "{camera} or {index}" if len(views) > 1 else "{tier}"
                text = f'--name "{self.template}" gives two images the same name; add {lacks} to --name'
                raise UsageError("USAGE", text)
            for name in names:
                for kind in self.kinds:
                    self.output.check_free(self.place(name, kind), label="--out")
        if self.options.film is not None and len({(view.width, view.height) for view in views}) > 1:
            raise UsageError("USAGE", "the cameras differ in size; pass --size WxH to make a film")

    def names(self, views: list[Camera], tier: str) -> list[str]:
        """Return the name of each image below the folder, without its suffix."""
        from msb.render.images import image_names

        if PurePath(self.template).is_absolute() or ".." in PurePath(self.template).parts:
            raise UsageError("USAGE", f'--name "{shorten(self.template)}" points outside the folder of --out')
        parts = re.split(r"{(\w*)}", self.template)
        if wrong := set(parts[1::2]) - {"camera", "tier", "index"}:
            raise UsageError(
                "USAGE", f'--name: "{{{wrong.pop()}}}" is unknown; use {{camera}}, {{tier}} or {{index}}'
            )
        values = [
            {"camera": camera, "tier": tier, "index": f"{index:05d}"}
            for index, camera in enumerate(image_names(views))
        ]
        # `parts` alternates between literal text (even positions) and names from braces (odd positions).
        return ["".join(row[part] if i % 2 else part for i, part in enumerate(parts)) for row in values]

    def place(self, name: str, kind: str) -> Path:
        """Return the file for one kind of output of the frame `name`."""
        folder = self.options.out or Path()
        if kind == "image":
            return folder / f"{name}.{self.options.format}"
        return folder / f"{name}_{kind}.{self.planes}"

    def draw(
        self, renderer: Renderer, views: list[Camera], color: tuple[float, float, float]
    ) -> list[dict[str, Any]]:
        """Render and write every view; return a row of JSON data for each."""
        from msb.render.images import Writers, write_film

        rows: list[dict[str, Any]] = []
        with self.output.counted("rendering", len(views)) as step, Writers() as writers:

            def images() -> Iterator[NDArray[Any]]:
                for name, view in zip(self.names(views, renderer.tier), views, strict=True):
                    frame = renderer.render(view, color)
                    rows.append(self.write(writers, name, view, frame))
                    step()
                    yield frame.image

            if self.options.film is not None:
                write_film(self.options.film, images(), self.options.fps, overwrite=self.output.force)
            else:
                for _ in images():
                    pass
        if not any(row["coverage"] for row in rows):
            text = "the cameras do not look at the asset, or use other coordinates; try --turntable 8"
            if self.options.turntable is not None:
                text = "the asset covers no pixel; its faces are transparent or too small"
            self.output.note(f"warning: all images are empty: {text}")
        if self.output.prints_text:
            self.print_summary(rows, renderer.tier)
        return rows

    def write(self, writers: Any, name: str, view: Camera, frame: Frame) -> dict[str, Any]:
        """Submit the requested planes of a frame to the file writers; return the frame's row of JSON data."""
        from msb.render.images import write_image

        row: dict[str, Any] = {"camera": view.name, "width": view.width, "height": view.height}
        row["coverage"] = float(frame.alpha.mean())
        row["sha256"] = hashlib.sha256(frame.image.tobytes()).hexdigest()
        row["timings_ms"] = dict(frame.timings)
        if self.options.out is None:
            return row
        planes = {"image": frame.image, "depth": frame.depth, "ids": frame.face_id}
        for kind in self.kinds:
            plane = planes[kind]
            if plane is None:
                raise UsageError("USAGE", "face ids are not available for this tier and method; omit --ids")
            target = self.place(name, kind)
            form = self.options.format if kind == "image" else self.planes
            writers.submit(write_image, target, plane, form, overwrite=self.output.force)
            row[kind] = str(target)
        return row

    def print_summary(self, rows: list[dict[str, Any]], tier: str) -> None:
        """Print the number of images and their hash; with --verbose, also print a line for each image."""
        where = [str(self.options.out)] if self.options.out is not None else []
        where += [str(self.options.film)] if self.options.film is not None else []
        plural = "" if len(rows) == 1 else "s"
        which = f", {tier}" if len(self.options.tiers) > 1 else ""
        total = hashlib.sha256("".join(row["sha256"] for row in rows).encode()).hexdigest()
        echo(f"{' and '.join(where)}: {len(rows)} view{plural}{which}, sha256 {total[:16]}")
        if self.output.verbose:
            for row in rows:
                stages = ", ".join(f"{key} {value:.3f}" for key, value in row["timings_ms"].items())
                size = f"{row['width']} x {row['height']}"
                echo(f"{row['camera']}: {size}, {stages} ms, sha256 {row['sha256'][:16]}")
