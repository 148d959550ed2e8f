"""`msb web --tier dedicated`: test views, what a smaller page costs, and how faithful a page is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.cli.output import echo
from msb.errors import DeviceError, GateFailed, InputError, UsageError

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.engines.dedicated_page.measure import Measured
    from msb.engines.dedicated_page.page import CheckView, Cost
    from msb.reference import ReferenceFrame
    from msb.scenes import Camera

    Color = tuple[float, float, float]

SCHEMA = "msb.web/1"
TEST_VIEWS = 4
"""Views by which a page is measured, evenly spread over the cameras."""
TEST_SIDE = 640
"""The most pixels of a side of a test view that we draw ourselves."""
WEIGHING_VIEWS = 16
"""Cameras, evenly spread, over which --faces sums what each face contributes."""
_ELEVATION = 20.0
_RENDERS = (".png", ".npy")


def write_page(
    asset: Asset,
    target: Path,
    output: Output,
    *,
    name: str,
    settings: Mapping[str, Any],
    cameras: Sequence[Camera],
    renders: Path | None,
    up: str,
    background: Color,
    quantise: bool,
    faces: int | None,
    verify: bool,
) -> None:
    """Write the page of `asset`, measured where a browser is at hand; tell what became of it."""
    from msb.base.atomic import new_file
    from msb.cli.camera_options import around
    from msb.engines.dedicated_page.page import CheckView, make_page
    from msb.engines.hardware.packing import pack

    with output.progress("checking the model"):
        pack(asset, settings)  # what cannot be drawn is said before anything takes long
    size = f"{TEST_SIDE}x{TEST_SIDE * 3 // 4}"
    seen = list(cameras) or around(asset, 2 * TEST_VIEWS, size, up, _ELEVATION)
    if renders is not None:
        tests = [_given(camera, renders, background) for camera in spread(cameras, TEST_VIEWS)]
        against = "the images of --renders"
    else:
        views = [_at_most(camera) for camera in spread(seen, TEST_VIEWS)]
        frames = _drawn(asset, views, background, settings, output, "drawing test views")
        images = [_bytes(frame.image) for frame in frames]
        tests = [CheckView(*pair) for pair in zip(views, [background] * len(views), images, strict=True)]
        against = "the reference renderer"
    smaller, costs = _smaller(
        asset,
        output,
        spread(seen, WEIGHING_VIEWS),
        tests,
        settings,
        quantise=quantise,
        faces=faces,
        drawn=renders is None,
    )
    with output.progress(f"packing {name}"):
        page = make_page(
            smaller,
            name=name,
            settings=settings,
            cameras=cameras,
            up=up,
            background=background,
            tests=tests,
            against=against,
            costs=costs,
            all_faces=asset.manifest.face_count,
        )
        data = page.encoded()
    found = None
    if verify:
        try:
            found = _measured(data, page.scene, [test.image for test in tests], output)
        except DeviceError as error:
            output.note(f"warning: {target.name} is not measured: {error.message}")
    if found is not None:
        page.record(found.by, found.psnr)
        data = page.encoded()
    with new_file(target, size=len(data)) as file:
        file.write(data)
    _tell(output, target, len(data), page.scene, found)


def verify_page(path: Path, output: Output, bar: float | None, *, device: str | None) -> None:
    """Measure a page again."""
    from msb.engines.dedicated_page.measure import FAITHFUL
    from msb.engines.dedicated_page.page import read_page

    limit = FAITHFUL if bar is None else bar
    with output.progress(f"reading {path.name}"):
        data, scene, images = read_page(path)
    if not images:
        raise InputError("FILE_NOT_RECOGNISED", "the page holds no test views to measure it by", file=path)
    found = _measured(data, scene, images, output, software=device != "gpu")
    _tell(output, path, len(data), scene, found, limit)
    if found.worst is not None and found.worst < limit:
        text = f"its worst view has {found.worst:.1f} dB, the bar is {limit:g} dB"
        raise GateFailed("GATE_FAILED", text, file=path)


def spread(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return `count` of the cameras, or all of them, evenly spread from the first one on."""
    if len(cameras) <= count:
        return list(cameras)
    return [cameras[k * len(cameras) // count] for k in range(count)]


def _at_most(camera: Camera) -> Camera:
    return camera.scaled(min(1.0, TEST_SIDE / max(camera.width, camera.height)))


def _drawn(
    asset: Asset,
    cameras: Sequence[Camera],
    background: Color,
    settings: Mapping[str, Any],
    output: Output,
    doing: str,
) -> Iterator[ReferenceFrame]:
    from msb.reference import render_reference

    with output.counted(doing, len(cameras)) as step:
        for camera in cameras:
            yield render_reference(asset, camera, background, settings)
            step()


def _bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    from msb.render.images import to_bytes

    return image if image.dtype == np.uint8 else to_bytes(image)


def _given(camera: Camera, folder: Path, background: Color) -> CheckView:
    """Return a test view with the image of that camera in a folder, in the image's size."""
    from pathlib import PurePosixPath

    from msb.engines.dedicated_page.page import CheckView
    from msb.metrics.image_files import read_image

    if camera.name is None:
        raise UsageError("USAGE", "--renders finds images by the names of cameras, and these have none")
    stem = PurePosixPath(camera.name).with_suffix("")
    places = [folder / f"{base}{suffix}" for base in (stem, stem.name) for suffix in _RENDERS]
    place = next((one for one in places if one.is_file()), places[-2])
    image = _bytes(read_image(place))
    return CheckView(camera.resized(image.shape[1], image.shape[0]), background, image)


def _smaller(
    asset: Asset,
    output: Output,
    seen: Sequence[Camera],
    tests: Sequence[CheckView],
    settings: Mapping[str, Any],
    *,
    quantise: bool,
    faces: int | None,
    drawn: bool,
) -> tuple[Asset, list[Cost]]:
    """Return what --faces and --quantise leave of an asset, and what each costs.

    `drawn`: the images of `tests` are ours.
    """
    from msb.engines.dedicated_page.measure import byte_psnr
    from msb.engines.dedicated_page.page import Cost
    from msb.engines.dedicated_page.smaller import quantised, with_faces

    found, costs = asset, []
    steps: list[tuple[str, Asset]] = []
    views = [test.camera for test in tests]
    background = tests[0].background
    total = asset.manifest.face_count
    if faces is not None and faces < total:
        frames = _drawn(
            asset, [_at_most(one) for one in seen], background, settings, output, "weighing faces"
        )
        weights = sum(frame.contribution for frame in frames if frame.contribution is not None)
        # The heaviest; of equal ones the first. They stay in their order.
        kept = np.sort(np.argsort(-np.broadcast_to(weights, total), kind="stable")[:faces])
        found = with_faces(found, kept)
        steps.append((f"{faces:,} of {total:,} faces (--faces)", found))
    if quantise:
        with output.progress("rounding values"):
            found = quantised(found)
        steps.append(("Rounded to 16 and 8 bits (--quantise)", found))
    before = [test.image for test in tests]
    if steps and not drawn:
        before = list(_images(asset, views, background, settings, output))
    for what, made in steps:
        after = list(_images(made, views, background, settings, output))
        values = [byte_psnr(*pair) for pair in zip(after, before, strict=True)]
        psnr = min((value for value in values if value is not None), default=None)
        costs.append(Cost(what, psnr))
        output.note(f"{what}: {_decibels(psnr)}, the worst of {len(views)} views, to what was there before")
        before = after
    return found, costs


def _images(
    asset: Asset, views: Sequence[Camera], background: Color, settings: Mapping[str, Any], output: Output
) -> Iterator[NDArray[np.uint8]]:
    for frame in _drawn(asset, views, background, settings, output, "drawing what it costs"):
        yield _bytes(frame.image)


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
    found: Measured | None,
    limit: float | None = None,
) -> None:
    about = scene["dedicated"]
    names = [test["name"] for test in about["tests"]]
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "path": str(path),
        "bytes": size,
        "method": about["title"],
        "faces": about["faces"],
        "against": about["against"],
        "costs": about["costs"],
        "measured": None,
    }
    if found is not None:
        rows = zip(names, found.psnr, found.milliseconds, strict=True)
        document["measured"] = {
            "browser": found.browser,
            "device": found.device,
            "format": found.format,
            "worst": found.worst,
            "views": [{"name": n, "psnr": p, "equal": p is None, "ms": ms} for n, p, ms in rows],
        }
    if limit is not None:
        document["at_least"] = limit
    output.write_json(document)
    if not output.prints_text or output.quiet:
        return
    echo(f"{path}")
    echo(f"{size / 1e6:.1f} MB, {about['title']}, {about['faces']:,} faces")
    if found is not None:
        for name, value in zip(names, found.psnr, strict=True):
            echo(f"  {name}: {_decibels(value)}")
        echo(f"worst {_decibels(found.worst)} to {about['against']}, in bytes ({found.by})")


def _decibels(value: float | None) -> str:
    return "equal" if value is None else f"{value:.1f} dB"
