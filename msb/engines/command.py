"""`msb web`: a page that shows a model in any browser, as engines draw it or as its method does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from msb.base.option import Argument, Option
from msb.cli.command import Typed, command, require
from msb.cli.output import JsonOutput, Output, echo, file_option
from msb.errors import DeviceError, GateFailed, InputError, UsageError
from msb.render.options import NO_CAMERAS, Drawing, Up, Views

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.engines.dedicated_page.measure import Measured
    from msb.engines.dedicated_page.page import BakedLook, CheckView, Cost
    from msb.registry import Tier
    from msb.scenes import Camera

# Views by which a page is measured, evenly spread over the cameras.
TEST_VIEWS = 4
# The most pixels of a side of a test view that we draw ourselves.
TEST_SIDE = 640
# Cameras, evenly spread, over which --faces sums what each face contributes.
WEIGHING_VIEWS = 16
_RENDERS = (".png", ".npy")


@dataclass(frozen=True)
class WebOptions:
    """What the page shows, and what a page of the dedicated tier may lose."""

    out: Annotated[
        Path | None,
        file_option("The page to write: .html.", "--out", "-o", endings=(".html", ".htm")),
    ] = None
    tier: Annotated[
        Literal["standard", "dedicated"],
        Option("The mesh as engines draw it, or also the method's own look, by WebGPU."),
    ] = "standard"
    verify: Annotated[
        Path | None,
        Option("Measure a page of the dedicated tier again, in a browser.", metavar="PAGE"),
    ] = None
    up: Annotated[Up | None, Option("Axis that points up. Default: the asset's.")] = None
    quantise: Annotated[bool, Option("Round positions to 16 bits and the rest to 8: a third in size.")] = (
        False
    )
    faces: Annotated[
        int | None, Option("Keep the N faces that contribute most over the cameras.", least=1)
    ] = None
    renders: Annotated[
        Path | None,
        Option(
            "With --cameras: official images, by names of cameras, to measure the page by.", metavar="DIR"
        ),
    ] = None
    baked: Annotated[
        Path | None,
        Option("Also show this plain asset, which msb bake made of it, with its dB.", metavar="FILE"),
    ] = None
    no_verify: Annotated[bool, Option("Do not measure the page in a browser.")] = False
    at_least: Annotated[
        float | None, Option("With --verify: fail below so many dB. Default: 45.", metavar="DB")
    ] = None
    device: Annotated[
        Literal["cpu", "gpu"] | None,
        Option("With --verify: the browser's software (default), or a graphics card."),
    ] = None


class Shown(NamedTuple):
    """What a page shows."""

    name: str
    asset: Asset
    settings: dict[str, Any]
    cameras: list[Camera]
    up: str
    background: tuple[float, float, float]


def _check_options(path: Path | None, options: WebOptions, views: Views, typed: Typed) -> None:
    """Reject options that contradict each other."""
    if options.verify is not None:
        only = {"verify", "at_least", "device", "json_file", "force", "quiet", "verbose"}
        common = {"color", "log_file", "debug"}
        typed.reject(typed.keys() - only - common, "does not go with --verify, which writes no page")
        return
    require(options.out, "Missing output. Pass -o with the page to write, or --verify PAGE")
    typed.reject(["at_least", "device"], "needs --verify PAGE")
    if path is None:
        require(options.tier == "standard", "--tier dedicated needs an ASSET")
        typed.reject(["cameras", "assignments", "up"], "needs an ASSET")
    if views.cameras is None:
        typed.reject(["camera", "size", "renders"], NO_CAMERAS)
    if options.tier == "standard":
        only_dedicated = ["quantise", "faces", "renders", "baked", "json_file", "no_verify"]
        typed.reject(only_dedicated, "needs --tier dedicated")


@command(
    "msb web -o out/page.html data_stubs/splat_like.triasset",
    "msb web -o out/views.html --cameras data_stubs/views.json --up=-y \\\n      data_stubs/checkpoint",
    "msb web -o out/look.html --tier dedicated --quantise --no-verify \\\n"
    "      --cameras data_stubs/views.json --scale 0.25 data_stubs/checkpoint",
    "msb web -o out/empty.html",
)
def web(
    path: Annotated[Path | None, Argument("A .triasset, checkpoint or mesh file.", metavar="ASSET")] = None,
    *,
    options: WebOptions,
    views: Views,
    drawing: Annotated[Drawing, ("assignments",)],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Write a page that shows a model in any browser, offline.

    The page of the standard tier turns the mesh that any engine draws; without an ASSET it waits for a .glb
    to be dropped. That of the dedicated tier shows the method's own look by WebGPU, the mesh beside it, and
    says how many dB its pixels have to those of the OpenCL renderer.
    """

    _check_options(path, options, views, typed)
    if options.verify is not None:
        verify_page(options.verify, options, output)
        return
    target = options.out or Path()
    if path is None:
        from msb.engines.webpage import page

        _write(target, page(background=views.color(None)), output)
        if not output.quiet:
            echo(str(target))
        return
    from msb.api.command_files import open_asset
    from msb.asset.look import up_axis
    from msb.views import choose_views

    asset = open_asset(path, output)
    said = ""
    if views.cameras is not None:
        cameras = views.read(output.note)
    else:
        chosen = choose_views(asset)
        cameras, said = [] if chosen.origin == "turntable" else chosen.cameras, chosen.said
    axis = options.up or up_axis(asset)
    color = views.color(asset)
    shown = Shown(path.name, asset, drawing.settings(asset), cameras, axis, color)
    if options.up is None and asset.manifest.coordinate_frame.up == "unknown":
        output.note(f"{path}: what is up is not known and taken to be {axis}; --up says otherwise")
    if said:
        output.note(f"views: {said}")
    if options.tier == "standard":
        _write_mesh(shown, target, output)
    else:
        write_page(shown, options, target, output)


def _write_mesh(shown: Shown, target: Path, output: Output) -> None:
    from msb.engines.engine import engine_mesh
    from msb.engines.webpage import LARGE, page
    from msb.render.backend import check_supported

    check_supported(shown.asset, "standard")
    mesh = engine_mesh(shown.asset, shown.settings)
    if len(mesh.indices) > LARGE:
        output.note(f"warning: {target}: {len(mesh.indices):,} faces are more than most browsers hold")
    with output.progress(f"writing {target.name}"):
        glb, background = mesh.encoded(".glb"), shown.background
        data = page(glb, name=shown.name, cameras=shown.cameras, up=shown.up, background=background)
        _write(target, data, output)
    if not output.quiet:
        echo(str(target))


def _write(target: Path, data: bytes, output: Output) -> None:
    from msb.base.atomic import new_file

    with new_file(target, size=len(data), overwrite=output.force) as file:
        file.write(data)


def write_page(shown: Shown, options: WebOptions, target: Path, output: Output) -> None:
    """Write the page of an asset, measured where a browser is at hand; tell what became of it."""
    from msb.api.command_files import open_baked
    from msb.engines.dedicated_page.page import CheckView, make_page
    from msb.engines.hardware.packing import pack
    from msb.scenes.around import around
    from msb.views import spread

    asset, background = shown.asset, shown.background
    with output.progress("checking the model"):
        pack(asset, shown.settings)  # what cannot be drawn is said before anything takes long
    made = None if options.baked is None else open_baked(options.baked, asset, output)
    seen = shown.cameras or around(asset, 2 * TEST_VIEWS, TEST_SIDE, TEST_SIDE * 3 // 4, shown.up)
    if options.renders is not None:
        tests = [_given(camera, options.renders, background) for camera in spread(seen, TEST_VIEWS)]
        against = "the images of --renders"
    else:
        cameras = [_at_most(camera) for camera in spread(seen, TEST_VIEWS)]
        images, against = _drawn(shown, asset, cameras, output, "drawing test views")
        tests = [CheckView(camera, background, image) for camera, image in zip(cameras, images, strict=True)]
    baked = None if made is None else _baked(shown, made, tests)
    smaller, costs = _smaller(shown, options, spread(seen, WEIGHING_VIEWS), tests, output)
    with output.progress(f"packing {shown.name}"):
        page = make_page(
            smaller,
            name=shown.name,
            settings=shown.settings,
            cameras=shown.cameras,
            up=shown.up,
            background=background,
            tests=tests,
            against=against,
            costs=costs,
            all_faces=asset.manifest.face_count,
            baked=baked,
        )
        data = page.encoded()
    measured = None
    if not options.no_verify:
        try:
            measured = _measured(data, page.scene, [test.image for test in tests], output)
        except DeviceError as error:
            output.note(f"warning: {target.name} is not measured: {error.message}")
    if measured is not None:
        page.record(measured.by, measured.psnr)
        data = page.encoded()
    _write(target, data, output)
    _tell(output, target, len(data), page.scene, measured)


def verify_page(path: Path, options: WebOptions, output: Output) -> None:
    """Measure a page again."""
    from msb.engines.dedicated_page.measure import FAITHFUL
    from msb.engines.dedicated_page.page import read_page

    limit = FAITHFUL if options.at_least is None else options.at_least
    with output.progress(f"reading {path.name}"):
        data, scene, images = read_page(path)
    if not images:
        raise InputError("FILE_NOT_RECOGNISED", "the page holds no test views to measure it by", file=path)
    measured = _measured(data, scene, images, output, software=options.device != "gpu")
    _tell(output, path, len(data), scene, measured, limit)
    if measured.worst < limit:
        text = f"its worst view has {measured.worst:.1f} dB, the bar is {limit:g} dB"
        raise GateFailed("GATE_FAILED", text, file=path)


def _at_most(camera: Camera) -> Camera:
    return camera.scaled(min(1.0, TEST_SIDE / max(camera.width, camera.height)))


def _drawn(
    shown: Shown, asset: Asset, cameras: Sequence[Camera], output: Output, doing: str
) -> tuple[list[NDArray[np.uint8]], str]:
    """Return what the method shows cameras, and what drew it: OpenCL, or NumPy where OpenCL cannot."""
    from msb.render import Renderer

    def images(tier: Tier) -> list[NDArray[np.uint8]]:
        with (
            Renderer(asset, tier, settings=shown.settings) as renderer,
            output.counted(doing, len(cameras)) as step,
        ):
            drawn = []
            for camera in cameras:
                drawn.append(_bytes(renderer.render(camera, shown.background).image))
                step()
            return drawn

    try:
        return images("dedicated"), "the OpenCL renderer"
    except DeviceError:
        return images("reference"), "the reference renderer"


def _bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    import numpy as np

    from msb.render.images import to_bytes

    return image if image.dtype == np.uint8 else to_bytes(image)


def _baked(shown: Shown, made: Asset, tests: Sequence[CheckView]) -> BakedLook:
    """Return what was baked of an asset, and how near the mesh of either comes to the test views."""
    from msb.asset.tiers import why_not
    from msb.engines.dedicated_page.page import BakedLook
    from msb.engines.engine import engine_mesh
    from msb.metrics import psnr
    from msb.metrics.images import PSNR_CAP
    from msb.render import Renderer

    def decibels(asset: Asset) -> float:
        with Renderer(asset, "standard") as renderer:
            drawn = [renderer.render(test.camera, test.background).image for test in tests]
        values = [psnr(image, test.image) for image, test in zip(drawn, tests, strict=True)]
        return sum(min(value, PSNR_CAP) for value in values) / len(values)

    plain = None if why_not(shown.asset.manifest, "standard") else decibels(shown.asset)
    return BakedLook(engine_mesh(made, {}).encoded(".glb"), decibels(made), plain)


def _given(camera: Camera, folder: Path, background: tuple[float, float, float]) -> CheckView:
    """Return a test view with the image of that camera in a folder, in the image's size."""
    from msb.engines.dedicated_page.page import CheckView
    from msb.metrics.image_files import read_image

    if camera.name is None:
        raise UsageError("USAGE", "--renders finds images by the names of cameras, and these have none")
    stem = PurePosixPath(camera.name).with_suffix("")
    places = [folder / f"{base}{suffix}" for base in (stem, stem.name) for suffix in _RENDERS]
    place = next((each for each in places if each.is_file()), places[-2])
    image = _bytes(read_image(place))
    return CheckView(camera.resized(image.shape[1], image.shape[0]), background, image)


def _smaller(
    shown: Shown, options: WebOptions, seen: Sequence[Camera], tests: Sequence[CheckView], output: Output
) -> tuple[Asset, list[Cost]]:
    """Return what --faces and --quantise leave of an asset, and what each costs."""
    import numpy as np

    from msb.engines.dedicated_page.page import Cost
    from msb.engines.dedicated_page.smaller import quantised, with_faces
    from msb.metrics import psnr

    smaller, faces = shown.asset, options.faces
    steps: list[tuple[str, Asset]] = []
    views = [test.camera for test in tests]
    total = smaller.manifest.face_count
    if faces is not None and faces < total:
        weights = _weighed(shown, [_at_most(camera) for camera in seen], output)
        # The heaviest; of equal ones the first. They stay in their order.
        kept = np.sort(np.argsort(-weights, kind="stable")[:faces])
        smaller = with_faces(smaller, kept)
        steps.append((f"{faces:,} of {total:,} faces (--faces)", smaller))
    if options.quantise:
        with output.progress("rounding values"):
            smaller = quantised(smaller)
        steps.append(("Rounded to 16 and 8 bits (--quantise)", smaller))

    def images(asset: Asset) -> list[NDArray[np.uint8]]:
        return _drawn(shown, asset, views, output, "drawing what it costs")[0]

    before = [test.image for test in tests]
    if steps and options.renders is not None:  # these are not ours
        before = images(shown.asset)
    costs = []
    for what, made in steps:
        after = images(made)
        worst = min(psnr(*pair) for pair in zip(after, before, strict=True))
        costs.append(Cost(what, worst))
        output.note(f"{what}: {_decibels(worst)}, the worst of {len(views)} views, to what was there before")
        before = after
    return smaller, costs


def _weighed(shown: Shown, cameras: Sequence[Camera], output: Output) -> NDArray[np.float64]:
    """Return what each face (F,) adds to the images of all cameras."""
    import numpy as np

    from msb.render.shares import shares_by_view

    weights = np.zeros(shown.asset.manifest.face_count)
    views = ((camera, None) for camera in cameras)
    with output.counted("weighing faces", len(cameras)) as step:
        for shares in shares_by_view(shown.asset, views, settings=shown.settings):
            if shares is not None:
                weights += shares[:, 0]
            step()
    return weights


def _measured(
    data: bytes,
    scene: Mapping[str, Any],
    images: Sequence[NDArray[np.uint8]],
    output: Output,
    *,
    software: bool = True,
) -> Measured:
    from msb.engines.dedicated_page.measure import measure_page

    with output.counted("measuring in a browser", len(images)) as step:
        return measure_page(data, scene, images, software=software, step=step)


def _tell(
    output: Output,
    path: Path,
    size: int,
    scene: Mapping[str, Any],
    measured: Measured | None,
    limit: float | None = None,
) -> None:
    about = scene["dedicated"]
    names = [test["name"] for test in about["tests"]]
    document: dict[str, Any] = {
        "schema": "msb.web/1",
        "path": str(path),
        "bytes": size,
        "method": about["title"],
        "faces": about["faces"],
        "against": about["against"],
        "costs": about["costs"],
        "measured": None,
    }
    if measured is not None:
        from msb.engines.dedicated_page.page import json_psnr

        rows = zip(names, map(json_psnr, measured.psnr), measured.milliseconds, strict=True)
        document["measured"] = {
            "browser": measured.browser,
            "device": measured.device,
            "format": measured.format,
            "worst": json_psnr(measured.worst),
            "views": [{"name": n, "psnr": p, "equal": p is None, "ms": ms} for n, p, ms in rows],
        }
    if limit is not None:
        document["at_least"] = limit
    output.write_json(document)
    if not output.prints_text or output.quiet:
        return
    echo(f"{path}")
    echo(f"{size / 1e6:.1f} MB, {about['title']}, {about['faces']:,} faces")
    if measured is not None:
        for name, value in zip(names, measured.psnr, strict=True):
            echo(f"  {name}: {_decibels(value)}")
        echo(f"worst {_decibels(measured.worst)} to {about['against']}, in bytes ({measured.by})")


def _decibels(value: float) -> str:
    return "equal" if math.isinf(value) else f"{value:.1f} dB"
