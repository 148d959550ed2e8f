"""`msb render`: images of an asset from a dataset's cameras, a turntable or a flight."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.cli.camera_options import (
    Assignments,
    Background,
    Cameras,
    Chosen,
    Ordering,
    RendererName,
    SamplingName,
    Scale,
    Size,
    Supersample,
    Tier,
)
from msb.cli.options import WRITTEN, DeviceName, Force, JsonFile, Quiet, Verbose, epilog, is_given
from msb.cli.output import Output, echo
from msb.cli.scene_options import (
    ImageFolder,
    Split,
    about_scene,
    note_training,
    refuse_beside_scene,
    scene_for,
    views_of,
)
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.render import Frame, Renderer
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

EPILOG = epilog(
    "msb render --turntable 8 -o out/turn data_stubs/splat_like.triasset",
    "msb render --turntable 12 --film out/t.mp4 data_stubs/checkpoint",
    "msb render --cameras data_stubs/views.json -o out data_stubs/checkpoint",
    "msb render --tier both --turntable 2 -o out/both data_stubs/checkpoint",
    "msb render --scene data_stubs/scenes/nerf_synthetic/pebble -o out/test \\\n"
    "      data_stubs/models/pebble/two_dts",
)
SCHEMA = "msb.render/1"
Up = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


def render(
    context: typer.Context,
    path: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FOLDER", help="Where images go.")
    ] = None,
    tier: Annotated[
        Literal["reference", "dedicated", "standard", "both"],
        typer.Option(help="How to draw; msb methods says what each tier keeps. both: dedicated, standard."),
    ] = "standard",
    cameras: Cameras = None,
    scene: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A dataset's scene instead of --cameras: views, size and background as msb run has them.",
        ),
    ] = None,
    split: Annotated[Split, typer.Option(help="With --scene: which of its views to draw.")] = "test",
    image_folder: ImageFolder = None,
    chosen: Chosen = None,
    turntable: Annotated[
        int | None, typer.Option(metavar="N", help="N cameras around the asset instead of --cameras.")
    ] = None,
    up: Annotated[
        Up | None, typer.Option(help="Axis of the turntable that points up. Default: the asset's.")
    ] = None,
    elevation: Annotated[
        float, typer.Option(metavar="DEGREES", help="Angle of the turntable's cameras above the horizon.")
    ] = 20.0,
    flight: Annotated[
        int | None, typer.Option(metavar="N", help="N cameras on a smooth path through the chosen ones.")
    ] = None,
    size: Size = None,
    scale: Scale = None,
    background: Background = None,
    form: Annotated[
        Literal["png", "npy", "exr"], typer.Option("--format", help="Format of the images.")
    ] = "png",
    template: Annotated[
        str | None,
        typer.Option(
            "--name",
            metavar="TEMPLATE",
            help="Names of the files: {camera}, {tier}, {index}. Default: {camera}, or {camera}_{tier}.",
        ),
    ] = None,
    depth: Annotated[bool, typer.Option("--depth", help="Also write depths (npy, or exr with it).")] = False,
    ids: Annotated[bool, typer.Option("--ids", help="Also write face ids; -1 means no face.")] = False,
    film: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a film, .mp4 or .gif."), WRITTEN
    ] = None,
    fps: Annotated[int, typer.Option(min=1, max=240, help="Frames per second of the film.")] = 24,
    assignments: Assignments = None,
    supersample: Supersample = 1,
    order: Ordering = None,
    sampling: SamplingName = None,
    renderer_name: RendererName = None,
    device: DeviceName = None,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Draw an asset: images, and depth and face ids if asked for.

    An image is named like its camera. PNG holds floor(255 c + 0.5) of the clamped colour as stored; npy and
    exr hold the floats as rendered, neither clamped nor rounded. The hash that is printed is of the floats of
    all images; it is the same on the same device with the same versions.
    """
    from msb.cli.camera_options import choose_cameras
    from msb.cli.inputs import open_asset
    from msb.scenes.datasets import scaled_note

    output = Output(json_file, quiet, verbose, force)
    if out is None and film is None:
        raise UsageError("USAGE", "give --out FOLDER for images, --film FILE for a film, or both")
    output.check_free(json_file)
    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    place: Scene | None = None
    if scene is not None:
        refuse_beside_scene(cameras=cameras, turntable=turntable, flight=flight, size=size, scale=scale)
        place = scene_for(asset, scene, image_folder)
        for warning in place.warnings:
            output.note(warning.to_line(warning.file or scene))
        if (note := scaled_note([place])) is not None:
            output.note(f"{scene}: {note}")
        views = choose_cameras(views_of(place, split), chosen, None, None)
    elif given := [name for name in ("split", "image_folder") if is_given(context, name)]:
        raise UsageError("USAGE", f"--{given[0].replace('_', '-')} goes with --scene DIR")
    else:
        views = _views(asset, cameras, chosen, turntable, up, elevation, flight, size, scale, output)
    tiers: tuple[Tier, ...] = ("dedicated", "standard") if tier == "both" else (tier,)
    task = _Task(output, out, form, depth, ids, film, fps, tiers, template)
    task.check(views)
    from msb.bench.machine import machine
    from msb.cli.camera_options import chosen_modes, parse_background
    from msb.render import Renderer
    from msb.render.backend import check_supported, lean_options

    color = parse_background(background, asset)
    if place is not None and not is_given(context, "background"):
        color = place.background  # a default that a file sets is no wish to draw what does not count
    if place is not None:
        note_training(asset, replace(place, background=color), path, output)
    settings = _settings(asset, assignments)
    modes = chosen_modes(order, sampling)
    for each in tiers:
        check_supported(asset, each)
    if len(tiers) > 1 and renderer_name is not None:
        raise UsageError("USAGE", "--renderer goes with one tier, not with --tier both")
    documents = []
    for each in tiers:
        # With --tier both, order and sampling go to dedicated, --supersample to standard.
        own = {} if len(tiers) > 1 and each == "standard" else modes
        options = lean_options(each, renderer_name, ids=ids) | own
        if supersample > 1 and (len(tiers) == 1 or each == "standard"):
            options["supersample"] = supersample
        with Renderer(asset, each, device, settings, name=renderer_name, **options) as renderer:
            rows = task.run(renderer, views, color)
            about = {"schema": SCHEMA, "path": str(path), "tier": each, "renderer": renderer.name, **own}
            where = {} if place is None else {"scene": about_scene(place, split)}
            drawn = {
                "background": list(color),
                "machine": machine(device, opencl=each != "reference", engine=renderer.device_info),
                "memory": dict(renderer.memory()),
                "frames": rows,
            }
            documents.append({**about, **where, **drawn})
    output.write_documents(documents)


def _settings(asset: Asset, assignments: list[str] | None) -> dict[str, Any]:
    from msb.asset.settings import parse_overrides

    return dict(parse_overrides(asset.manifest.method, assignments or []))


def _views(
    asset: Asset,
    cameras: str | None,
    chosen: list[str] | None,
    turntable: int | None,
    up: str | None,
    elevation: float,
    flight: int | None,
    size: str | None,
    scale: float | None,
    output: Output,
) -> list[Camera]:
    """Return the cameras that the options describe."""

    from msb.cli.camera_options import around, cameras_at
    from msb.scenes import interpolated

    if (cameras is None) == (turntable is None):
        raise UsageError("USAGE", "give one of --cameras PATH, --scene DIR and --turntable N")
    if turntable is not None:
        if chosen or flight or scale is not None:
            raise UsageError("USAGE", "--turntable goes without --camera, --flight and --scale")
        return around(asset, turntable, size, up, elevation)
    found = cameras_at(str(cameras), chosen, size, scale, output)
    if flight is None:
        return found
    return [replace(camera, name=f"{index:05d}") for index, camera in enumerate(interpolated(found, flight))]


class _Task:
    """What is to be written for each frame, and where."""

    def __init__(
        self,
        output: Output,
        out: Path | None,
        form: str,
        depth: bool,
        ids: bool,
        film: Path | None,
        fps: int,
        tiers: tuple[Tier, ...],
        template: str | None,
    ) -> None:
        self.output, self.out, self.film, self.fps = output, out, film, fps
        self.tiers = tiers
        self.template = template or ("{camera}" if len(tiers) == 1 else "{camera}_{tier}")
        self.form: Any = form
        planes: Any = "exr" if form == "exr" else "npy"
        self.planes = planes
        self.kinds = ["image", *(["depth"] if depth else []), *(["ids"] if ids else [])]
        if out is None and len(self.kinds) > 1:
            raise UsageError("USAGE", "--depth and --ids need --out FOLDER")
        if film is not None and len(tiers) > 1:
            raise UsageError("USAGE", "--film goes with one tier, not with --tier both")
        from msb.render.images import check_film, check_format

        check_format(form)
        if film is not None:
            check_film(film)

    def check(self, views: list[Camera]) -> None:
        """Refuse to overwrite, before anything is rendered."""
        if self.film is not None:
            self.output.check_free(self.film)
        names = [name for tier in self.tiers for name in self.names(views, tier)]
        if self.out is not None:
            if len(set(names)) < len(names):
                lacks = "{camera} or {index}" if len(views) > 1 else "{tier}"
                text = f'--name "{self.template}" gives two images one name; it may lack {lacks}'
                raise UsageError("USAGE", text)
            for name in names:
                for kind in self.kinds:
                    self.output.check_free(self.place(name, kind))
        if self.film is not None and len({(view.width, view.height) for view in views}) > 1:
            raise UsageError("USAGE", "the cameras differ in size; --size WxH makes a film possible")

    def names(self, views: list[Camera], tier: str) -> list[str]:
        """Return the name of each image below the folder, without its suffix."""
        from msb.render.images import image_names

        if PurePath(self.template).is_absolute() or ".." in PurePath(self.template).parts:
            raise UsageError("USAGE", f'--name "{shorten(self.template)}" leads out of --out FOLDER')
        found = []
        for index, camera in enumerate(image_names(views)):
            known = {"camera": camera, "tier": tier, "index": f"{index:05d}"}
            parts = re.split(r"{(\w*)}", self.template)
            if wrong := set(parts[1::2]) - set(known):
                text = f'--name: "{{{wrong.pop()}}}" is none of {{camera}}, {{tier}}, {{index}}'
                raise UsageError("USAGE", text)
            found.append("".join(known[part] if odd % 2 else part for odd, part in enumerate(parts)))
        return found

    def place(self, name: str, kind: str) -> Path:
        """Return the file for one kind of output of the frame `name`."""
        folder = self.out or Path()
        if kind == "image":
            return folder / f"{name}.{self.form}"
        return folder / f"{name}_{kind}.{self.planes}"

    def run(
        self, renderer: Renderer, views: list[Camera], color: tuple[float, float, float]
    ) -> list[dict[str, Any]]:
        """Render and write every view; return a row of JSON for each."""
        from msb.render.images import Writers, write_film

        rows: list[dict[str, Any]] = []
        with self.output.counted("rendering", len(views)) as step, Writers() as writers:

            def images() -> Iterator[NDArray[Any]]:
                for name, view in zip(self.names(views, renderer.tier), views, strict=True):
                    frame = renderer.render(view, color)
                    rows.append(self.write(writers, name, view, frame))
                    step()
                    yield frame.image

            if self.film is not None:
                write_film(self.film, images(), self.fps)
            else:
                for _ in images():
                    pass
        if not any(row["coverage"] for row in rows):
            text = (
                "warning: no picture shows any of it: the cameras look elsewhere, or are of other coordinates"
            )
            self.output.note(f"{text}; --turntable 8 looks at all of it")
        if self.output.prints_text:
            self.say(rows, renderer.tier)
        return rows

    def write(self, writers: Any, name: str, view: Camera, frame: Frame) -> dict[str, Any]:
        """Hand the frame's planes to the writers; return what the JSON says of it."""
        from msb.render.images import write_image

        row: dict[str, Any] = {"camera": view.name, "width": view.width, "height": view.height}
        row["coverage"] = float(frame.alpha.mean())
        row["sha256"] = hashlib.sha256(frame.image.tobytes()).hexdigest()
        row["timings_ms"] = dict(frame.timings)
        if self.out is None:
            return row
        planes = {"image": frame.image, "depth": frame.depth, "ids": frame.face_id}
        for kind in self.kinds:
            plane = planes[kind]
            if plane is None:
                raise UsageError("USAGE", "this tier and method have no face ids; leave out --ids")
            target = self.place(name, kind)
            writers.submit(write_image, target, plane, self.form if kind == "image" else self.planes)
            row[kind] = str(target)
        return row

    def say(self, rows: list[dict[str, Any]], tier: str) -> None:
        """Print what was made, in a line or a few."""
        where = [str(self.out)] if self.out is not None else []
        where += [str(self.film)] if self.film is not None else []
        plural = "" if len(rows) == 1 else "s"
        which = f", {tier}" if len(self.tiers) > 1 else ""
        total = hashlib.sha256("".join(row["sha256"] for row in rows).encode()).hexdigest()
        echo(f"{' and '.join(where)}: {len(rows)} view{plural}{which}, sha256 {total[:16]}")
        if self.output.verbose:
            for row in rows:
                stages = ", ".join(f"{key} {value:.3f}" for key, value in row["timings_ms"].items())
                size = f"{row['width']} x {row['height']}"
                echo(f"{row['camera']}: {size}, {stages} ms, sha256 {row['sha256'][:16]}")
