"""`msb web` writes a page that shows a model in any browser, on the standard or on the dedicated tier."""

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
from msb.render.options import NO_CAMERAS, ONLY_GENERATED, RendererOptions, Up, ViewOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.engines.dedicated_page.measurement import Measurement
    from msb.engines.dedicated_page.page import BakedMesh, CheckView, Cost
    from msb.registry import Tier
    from msb.scenes import Camera

# Number of test views of a page, evenly spread over the cameras.
TEST_VIEWS = 4
# Largest width or height in pixels of a test view that we render; larger cameras are scaled down.
TEST_SIDE = 640
# --faces sums the contribution of each face over this number of evenly spread cameras.
WEIGHING_VIEWS = 16
# File endings of the images of --renders.
_IMAGE_ENDINGS = (".png", ".npy")


@dataclass(frozen=True)
class WebOptions:
    """Options of a page: its renderer tier, reductions of the model, and the measurement."""

    out: Annotated[
        Path | None,
        file_option("The page to write, a .html file.", "--out", "-o", endings=(".html", ".htm")),
    ] = None
    tier: Annotated[
        Literal["standard", "dedicated"],
        Option(
            "Show the mesh as an ordinary renderer draws it (standard), or also the native rendering "
            "(dedicated)."
        ),
    ] = "standard"
    verify: Annotated[
        Path | None,
        Option("Measure an existing page of the dedicated tier in a browser.", metavar="PAGE"),
    ] = None
    up: Annotated[Up | None, Option("Axis that points up. Default: the up axis of the asset.")] = None
    quantise: Annotated[
        bool,
        Option("Round positions to 16 bits and other values to 8 bits, which reduces the size to a third."),
    ] = False
    faces: Annotated[
        int | None, Option("Keep only the N faces that contribute most to the images.", least=1)
    ] = None
    renders: Annotated[
        Path | None,
        Option(
            "With --cameras: compare the page with the official images in DIR. A file name is a camera name.",
            metavar="DIR",
        ),
    ] = None
    baked: Annotated[
        Path | None,
        Option("Also show FILE, a mesh that msb bake wrote for this model, and its PSNR.", metavar="FILE"),
    ] = None
    no_verify: Annotated[bool, Option("Do not measure the page in a browser.")] = False
    at_least: Annotated[
        float | None,
        Option("With --verify: fail if the PSNR of a test view is below DB. Default: 45.", metavar="DB"),
    ] = None
    device: Annotated[
        Literal["cpu", "gpu"] | None,
        Option("With --verify: draw with the browser's software renderer (cpu, the default) or a GPU."),
    ] = None


class PageContent(NamedTuple):
    """The asset of a page, its display options, and its baked mesh.

    Meshes and cameras are relative to the origin of the asset.
    """

    name: str
    asset: Asset
    settings: dict[str, Any]
    cameras: list[Camera]
    up: str
    background: tuple[float, float, float]
    baked: Asset | None = None


def _check_options(path: Path | None, options: WebOptions, views: ViewOptions, typed: Typed) -> None:
    """Reject missing options and invalid combinations."""
    if options.verify is not None:
        only = {"verify", "at_least", "device", "json_file", "force", "quiet", "verbose"}
        common = {"color", "log_file", "debug"}
        typed.reject(typed.keys() - only - common, "cannot be combined with --verify, which writes no page")
        return
    require(options.out, "Missing output. Pass -o with the page to write, for example -o page.html")
    typed.reject(["at_least", "device"], "needs --verify PAGE")
    if path is None:
        require(options.tier == "standard", "--tier dedicated needs an ASSET")
        typed.reject(["cameras", "kind", "assignments", "up"], "needs an ASSET")
    if views.cameras is None:
        typed.reject(["camera", "size", "renders"], NO_CAMERAS)
    else:
        typed.reject(["kind"], ONLY_GENERATED)
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
    views: ViewOptions,
    drawing: Annotated[RendererOptions, ("assignments",)],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Write a page that shows a model in any browser, offline.

    On the standard tier the page shows the mesh as an ordinary renderer draws it. Without an ASSET, the page
    shows a .glb file that is dropped on it. On the dedicated tier the page shows the native rendering, drawn
    with WebGPU, next to the mesh. The page also shows the PSNR of its images, compared with the OpenCL
    renderer.
    """

    _check_options(path, options, views, typed)
    if options.verify is not None:
        verify_page(options.verify, options, output)
        return
    target = options.out or Path()
    if path is None:
        from msb.engines.webpage import make_mesh_page

        _write(target, make_mesh_page(background=views.color(None)), output)
        if not output.quiet:
            echo(str(target))
        return
    from msb.api.command_files import open_asset, open_baked
    from msb.asset.look import up_axis
    from msb.asset.origin import without_origin
    from msb.views import choose_views

    asset = open_asset(path, output)
    origin = ""
    if views.cameras is not None:
        cameras = views.read(output.note)
    else:
        chosen = choose_views(asset, kind=views.kind)
        cameras, origin = [] if chosen.origin == "turntable" else chosen.cameras, chosen.description
    axis = options.up or up_axis(asset)
    color = views.color(asset)
    # A page computes in float32, so its mesh and cameras are relative to the origin of the asset.
    baked = None if options.baked is None else open_baked(options.baked, asset, output)
    cameras = [camera.relative_to(asset.manifest.origin) for camera in cameras]
    place = path.name, without_origin(asset), drawing.settings(asset), cameras, axis, color
    content = PageContent(*place, None if baked is None else without_origin(baked))
    if options.up is None and asset.manifest.coordinate_frame.up == "unknown":
        output.note(f"{path}: the up axis is unknown; {axis} is used. Set it with --up, for example --up=-y")
    if origin:
        output.note(f"views: {origin}")
    if options.tier == "standard":
        _write_mesh_page(content, target, output)
    else:
        write_page(content, options, target, output)


def _write_mesh_page(content: PageContent, target: Path, output: Output) -> None:
    """Write the page of the standard tier."""
    from msb.engines.engine import engine_mesh
    from msb.engines.webpage import LARGE, make_mesh_page
    from msb.render.backend import check_supported
    from msb.scenes.framing import find_framing

    check_supported(content.asset, "standard")
    mesh = engine_mesh(content.asset, content.settings)
    if len(mesh.indices) > LARGE:
        output.note(f"warning: {target}: {len(mesh.indices):,} faces are too many for most browsers")
    with output.progress(f"writing {target.name}"):
        glb, background = mesh.to_bytes(".glb"), content.background
        data = make_mesh_page(
            glb,
            name=content.name,
            cameras=content.cameras,
            up=content.up,
            background=background,
            framing=find_framing(content.asset),
        )
        _write(target, data, output)
    if not output.quiet:
        echo(str(target))


def _write(target: Path, data: bytes, output: Output) -> None:
    from msb.base.atomic import new_file

    with new_file(target, size=len(data), overwrite=output.force) as file:
        file.write(data)


def write_page(content: PageContent, options: WebOptions, target: Path, output: Output) -> None:
    """Write the page of the dedicated tier and print a summary; measure the page if there is a browser."""
    from msb.engines.dedicated_page.page import CheckView, make_page
    from msb.engines.hardware.packing import pack
    from msb.scenes.around import make_turntable
    from msb.views import spread_evenly

    asset, background = content.asset, content.background
    with output.progress("checking the model"):
        pack(asset, content.settings)  # report unsupported models before the slow steps
    cameras = content.cameras or make_turntable(
        asset, 2 * TEST_VIEWS, TEST_SIDE, TEST_SIDE * 3 // 4, content.up
    )
    if options.renders is not None:
        folder = options.renders
        tests = [_read_test_view(camera, folder, background) for camera in spread_evenly(cameras, TEST_VIEWS)]
        against = "the images of --renders"
    else:
        small = [_limit_size(camera) for camera in spread_evenly(cameras, TEST_VIEWS)]
        images, against = _draw_native(content, asset, small, output, "drawing test views")
        tests = [CheckView(camera, background, image) for camera, image in zip(small, images, strict=True)]
    baked = None if content.baked is None else _measure_baked(content, content.baked, tests)
    reduced, costs = _reduce(content, options, spread_evenly(cameras, WEIGHING_VIEWS), tests, output)
    with output.progress(f"packing {content.name}"):
        page = make_page(
            reduced,
            name=content.name,
            settings=content.settings,
            cameras=content.cameras,
            up=content.up,
            background=background,
            tests=tests,
            against=against,
            costs=costs,
            all_faces=asset.manifest.face_count,
            baked=baked,
        )
        data = page.to_bytes()
    measured = None
    if not options.no_verify:
        try:
            measured = _measure(data, page.scene, [test.image for test in tests], output)
        except DeviceError as error:
            output.note(f"warning: {target.name} was written but not measured: {error.message}")
    if measured is not None:
        page.record(measured.by, measured.psnr)
        data = page.to_bytes()
    _write(target, data, output)
    _report(output, target, len(data), page.scene, measured)


def verify_page(path: Path, options: WebOptions, output: Output) -> None:
    """Measure an existing page; raise GATE_FAILED if the PSNR of a view is below --at-least."""
    from msb.engines.dedicated_page.measurement import FAITHFUL
    from msb.engines.dedicated_page.page import read_page

    limit = FAITHFUL if options.at_least is None else options.at_least
    with output.progress(f"reading {path.name}"):
        data, scene, images = read_page(path)
    if not images:
        raise InputError("FILE_NOT_RECOGNISED", "the page has no test views to measure", file=path)
    measured = _measure(data, scene, images, output, software=options.device != "gpu")
    _report(output, path, len(data), scene, measured, limit)
    if measured.worst < limit:
        text = f"the worst view has a PSNR of {measured.worst:.1f} dB; at least {limit:g} dB are required"
        raise GateFailed("GATE_FAILED", text, file=path)


def _limit_size(camera: Camera) -> Camera:
    """Return the camera, scaled down so that no side of its image exceeds TEST_SIDE."""
    return camera.scaled(min(1.0, TEST_SIDE / max(camera.width, camera.height)))


def _draw_native(
    content: PageContent, asset: Asset, cameras: Sequence[Camera], output: Output, doing: str
) -> tuple[list[NDArray[np.uint8]], str]:
    """Return the native renderings (H, W, 3) of all cameras, and the name of the renderer.

    The OpenCL renderer draws the images; on machines without a device, the NumPy reference draws them.
    `doing` describes the activity in the progress bar.
    """
    from msb.render import Renderer

    def images(tier: Tier) -> list[NDArray[np.uint8]]:
        with (
            Renderer(asset, tier, settings=content.settings) as renderer,
            output.counted(doing, len(cameras)) as step,
        ):
            frames = []
            for camera in cameras:
                frames.append(_as_bytes(renderer.render(camera, content.background).image))
                step()
            return frames

    try:
        return images("dedicated"), "the OpenCL renderer"
    except DeviceError:
        return images("reference"), "the reference renderer"


def _as_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    import numpy as np

    from msb.render.images import to_bytes

    return image if image.dtype == np.uint8 else to_bytes(image)


def _measure_baked(content: PageContent, baked: Asset, tests: Sequence[CheckView]) -> BakedMesh:
    """Return the baked mesh, its average PSNR, and the average PSNR of the standard-tier mesh."""
    from msb.asset.tiers import why_not
    from msb.engines.dedicated_page.page import BakedMesh
    from msb.engines.engine import engine_mesh
    from msb.metrics import psnr
    from msb.metrics.images import PSNR_CAP
    from msb.render import Renderer

    def decibels(asset: Asset) -> float:
        with Renderer(asset, "standard") as renderer:
            images = [renderer.render(test.camera, test.background).image for test in tests]
        values = [psnr(image, test.image) for image, test in zip(images, tests, strict=True)]
        return sum(min(value, PSNR_CAP) for value in values) / len(values)

    plain = None if why_not(content.asset.manifest, "standard") else decibels(content.asset)
    return BakedMesh(engine_mesh(baked, {}).to_bytes(".glb"), decibels(baked), plain)


def _read_test_view(camera: Camera, folder: Path, background: tuple[float, float, float]) -> CheckView:
    """Return a test view whose image is read from `folder`. The camera gets the size of the image."""
    from msb.engines.dedicated_page.page import CheckView
    from msb.metrics.image_files import read_image

    if camera.name is None:
        raise UsageError("USAGE", "--renders finds images by camera names, but a camera has no name")
    # The name of a camera can contain subfolders. The image may lie in subfolders, or directly in the folder.
    stem = PurePosixPath(camera.name).with_suffix("")
    paths = [folder / f"{base}{suffix}" for base in (stem, stem.name) for suffix in _IMAGE_ENDINGS]
    image = _as_bytes(read_image(next((path for path in paths if path.is_file()), paths[-2])))
    return CheckView(camera.resized(image.shape[1], image.shape[0]), background, image)


def _reduce(
    content: PageContent,
    options: WebOptions,
    cameras: Sequence[Camera],
    tests: Sequence[CheckView],
    output: Output,
) -> tuple[Asset, list[Cost]]:
    """Apply --faces and --quantise. Return the reduced asset and the quality loss of each step.

    The cameras in `cameras` determine the contribution of each face. The views in `tests` measure the losses.
    """
    import numpy as np

    from msb.engines.dedicated_page.page import Cost
    from msb.engines.dedicated_page.reduction import quantise, select_faces
    from msb.metrics import psnr

    reduced, faces = content.asset, options.faces
    steps: list[tuple[str, Asset]] = []
    views = [test.camera for test in tests]
    total = reduced.manifest.face_count
    if faces is not None and faces < total:
        weights = _sum_contributions(content, [_limit_size(camera) for camera in cameras], output)
        # Select the faces with the largest contributions; among equal contributions, select the first faces.
        # Keep their order.
        selected = np.sort(np.argsort(-weights, kind="stable")[:faces])
        reduced = select_faces(reduced, selected)
        steps.append((f"{faces:,} of {total:,} faces (--faces)", reduced))
    if options.quantise:
        with output.progress("rounding values"):
            reduced = quantise(reduced)
        steps.append(("Values rounded to 16 and 8 bits (--quantise)", reduced))

    def draw(asset: Asset) -> list[NDArray[np.uint8]]:
        return _draw_native(content, asset, views, output, "measuring the reduced model")[0]

    before = [test.image for test in tests]
    if (
        steps and options.renders is not None
    ):  # compare with our native rendering, not with the images of --renders
        before = draw(content.asset)
    costs = []
    for title, asset in steps:
        after = draw(asset)
        worst = min(psnr(*pair) for pair in zip(after, before, strict=True))
        costs.append(Cost(title, worst))
        quality = (
            "images unchanged"
            if math.isinf(worst)
            else f"PSNR {worst:.1f} dB against the images before this step"
        )
        output.note(f"{title}: {quality}, in the worst of {len(views)} views")
        before = after
    return reduced, costs


def _sum_contributions(
    content: PageContent, cameras: Sequence[Camera], output: Output
) -> NDArray[np.float64]:
    """Return the contribution (F,) of each face: the sum of its blending weights over all pixels."""
    import numpy as np

    from msb.render.shares import shares_by_view

    weights = np.zeros(content.asset.manifest.face_count)
    views = ((camera, None) for camera in cameras)
    with output.counted("summing the contributions of faces", len(cameras)) as step:
        for shares in shares_by_view(content.asset, views, settings=content.settings):
            if shares is not None:
                weights += shares[:, 0]
            step()
    return weights


def _measure(
    data: bytes,
    scene: Mapping[str, Any],
    images: Sequence[NDArray[np.uint8]],
    output: Output,
    *,
    software: bool = True,
) -> Measurement:
    """Measure a page in a browser, with a progress bar."""
    from msb.engines.dedicated_page.measurement import measure_page

    with output.counted("measuring in a browser", len(images)) as step:
        return measure_page(data, scene, images, software=software, step=step)


def _report(
    output: Output,
    path: Path,
    size: int,
    scene: Mapping[str, Any],
    measured: Measurement | None,
    limit: float | None = None,
) -> None:
    """Write the JSON results of a page and print a summary; `limit` is the minimum PSNR in dB."""
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
        from msb.engines.dedicated_page.page import psnr_to_json

        rows = zip(names, map(psnr_to_json, measured.psnr), measured.milliseconds, strict=True)
        document["measured"] = {
            "browser": measured.browser,
            "device": measured.device,
            "format": measured.format,
            "worst": psnr_to_json(measured.worst),
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
        echo(f"PSNR of the test views, drawn by {measured.by}, against {about['against']}:")
        for name, value in zip(names, measured.psnr, strict=True):
            echo(f"  {name}: {_format_db(value)}")
        echo(f"  worst view: {_format_db(measured.worst)}")


def _format_db(value: float) -> str:
    return "identical" if math.isinf(value) else f"{value:.1f} dB"
