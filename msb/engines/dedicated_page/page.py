"""The page of the dedicated tier: an asset and the plan of its frames in one file, and what is read back."""

import base64
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import colors_of, shown_faces
from msb.asset.settings import effective_settings
from msb.asset.strict_json import parse_strict_json
from msb.base.files import read_file
from msb.engines.dedicated_page.stored import restore, store
from msb.engines.hardware.packing import VIEW, Packed, make_native_model, pack
from msb.engines.hardware.plan import Limits, Plan
from msb.engines.hardware.program import make_plan
from msb.engines.webpage import camera_data, filled, scene_data
from msb.errors import DeviceError, InputError, MsbError
from msb.registry import Order, Sampling, lookup
from msb.render.splat.model import Model
from msb.render.surface import Surface
from msb.scenes import Camera
from msb.scenes.colors import Color

SCRIPTS = (
    *("camera.js", "page.js", "hands.js", "store.js", "dedicated.js"),
    *("official.js", "faithful.js", "start.js"),
)
# What every device with WebGPU takes.
_GUARANTEED = Limits(binding=1 << 27, buffer=1 << 28, side=8192)
# What most graphics cards of computers take; the page asks for what it needs, and says so if it cannot.
_LARGER = Limits(binding=1 << 30, buffer=1 << 31, side=8192)
# Chunks in which faces are blended: fewer than in the renderer, because each one reads all samples.
STOPS = 8
# Orders and samplings that a page offers.
MODES: tuple[tuple[Order, Sampling], ...] = (
    *(("tile", "official"), ("global", "official"), ("none", "official")),
    *(("tile", "engine"), ("none", "engine")),  # an engine has no tiles: "global" is "tile"
)
_TYPES = {"f": "f32", "i": "i32", "u": "u32"}
# Base64 letters of an element.
_LETTERS = 1 << 23
# Bytes of all images of test views together that are read.
_MOST_OF_TESTS = 1 << 30
_ARRAY = re.compile(rb'<script type="text/plain" data-array="([^"]*)">([^<]*)</script>')
_SCENE = re.compile(rb'<script type="application/json" id="scene">(.*?)</script>', re.DOTALL)


def json_psnr(value: float) -> float | None:
    """Return a PSNR as JSON has it: None if the images are equal."""
    return None if math.isinf(value) else value


@dataclass(frozen=True)
class CheckView:
    """A view by which a page is measured: what it should show, (H, W, 3) uint8."""

    camera: Camera
    background: Color
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class Cost:
    """What making a page smaller took: what was done, and the worst PSNR in dB to what was there before."""

    what: str
    psnr: float


@dataclass(frozen=True)
class BakedLook:
    """A plain asset that was baked of the model, as GLB with colours as stored, where the model is.

    `psnr` is its mean dB to the test views with one sample a pixel, `plain` that of the standard tier, if
    there is one.
    """

    glb: bytes
    psnr: float
    plain: float | None


@dataclass
class DedicatedPage:
    """Everything that goes into a page: its JSON, and the elements that hold arrays.

    `encoded` may be called again when the page has been measured, which `record` puts into the scene.
    """

    scene: dict[str, Any]
    arrays: str = field(repr=False)
    glb: bytes = field(default=b"", repr=False)

    def encoded(self) -> bytes:
        """Return the file."""
        encoded = base64.b64encode(self.glb).decode("ascii")
        return filled(self.scene, SCRIPTS, glb=encoded, arrays=self.arrays)

    def record(self, by: str, psnr: Sequence[float]) -> None:
        """Note the PSNR of the page's pixels to each test view, in dB, and who drew them."""
        self.scene["dedicated"]["measured"] = {"by": by, "psnr": list(map(json_psnr, psnr))}


def make_page(
    asset: Asset,
    *,
    name: str,
    settings: Mapping[str, Any],
    cameras: Sequence[Camera] = (),
    up: str = "+y",
    background: Color = (0.0, 0.0, 0.0),
    tests: Sequence[CheckView] = (),
    against: str = "the reference renderer",
    costs: Sequence[Cost] = (),
    all_faces: int | None = None,
    baked: BakedLook | None = None,
) -> DedicatedPage:
    """Return the page of an asset, turned about the axis `up`, with `cameras` to choose from.

    It is measured by `tests`, whose images were made by `against`. `costs` are what making the asset smaller
    has cost, `all_faces` those of the whole model. What was `baked` of it is a look of its own.
    """
    packed = pack(asset, settings)
    try:
        limits = _GUARANTEED
        plans = _plans(packed, limits, "every browser")
    except DeviceError:
        limits = _LARGER
        plans = _plans(packed, limits, "WebGPU on most graphics cards")
    kept: dict[str, tuple[dict[str, Any], bytes]] = {}

    def keep(array_name: str, array: NDArray[Any]) -> str:
        stored = store(array)
        kept[array_name] = stored.head, stored.data
        return array_name

    plan = plans[MODES[0]]
    for array_name, array in plan.data.items():
        if array_name == "positions":
            _keep_positions(asset, packed, keep, kept)
        else:
            keep(array_name, array)
    modules: list[str] = []
    records = []
    for (order, sampling), other in plans.items():
        arrays = {}
        for buffer, array in other.data.items():
            same = buffer in plan.data and np.array_equal(array, plan.data[buffer])
            arrays[buffer] = buffer if same else keep(f"{buffer}, {order}, {sampling}", array)
        record = other.record()
        modules += [text for text in record["modules"].values() if text not in modules]
        record["modules"] = {key: modules.index(text) for key, text in record["modules"].items()}
        records.append({"order": order, "sampling": sampling, "arrays": arrays, **record})
    buffers = [entry for other in plans.values() for entry in other.buffers.values()]
    values = effective_settings(asset.manifest, settings)
    standard = _standard(asset, packed, values, keep, kept)
    listed = []
    for k, test in enumerate(tests):
        image = keep(f"test {k}", test.image.reshape(-1, 3))
        listed.append(
            {
                "name": test.camera.name or str(k),
                "view": camera_data(test.camera),
                "background": list(test.background),
                "image": image,
            }
        )
    scene = scene_data(name, cameras, up, background)
    scene["dedicated"] = {
        "title": lookup(asset.manifest.method).title,
        "faces": packed.faces,
        "all_faces": all_faces or packed.faces,
        "plans": records,
        "modules": modules,
        "view": _camera_record(packed),
        "settings": _live_settings(asset, settings, packed.model),
        "needs": {
            "maxStorageBufferBindingSize": _needed(buffers, limits.binding, _GUARANTEED.binding),
            "maxBufferSize": _needed(buffers, limits.buffer, _GUARANTEED.buffer),
        },
        "arrays": {key: head for key, (head, _) in kept.items()},
        "standard": standard,
        "sphere": _seen_sphere(asset),
        "tests": listed,
        "against": against,
        "measured": None,
        "costs": [{"what": cost.what, "psnr": json_psnr(cost.psnr)} for cost in costs],
        "baked": None if baked is None else {"psnr": baked.psnr, "plain": baked.plain},
    }
    elements = "\n".join(_elements((key, data) for key, (_, data) in kept.items()))
    return DedicatedPage(scene, elements, b"" if baked is None else baked.glb)


def _plans(packed: Packed, limits: Limits, name: str) -> dict[tuple[Order, Sampling], Plan]:
    """Return (order, sampling) -> the plan of a frame, the official one first; equal ones are left out."""
    plans = {}
    for order, sampling in MODES:
        if packed.surface is None or order == "tile":  # a z-buffer has no order
            plans[order, sampling] = make_plan(
                packed, limits, name, order=order, sampling=sampling, stops=STOPS, depth=False
            )
    return plans


def _camera_record(packed: Packed) -> dict[str, Any]:
    """Return what the camera record is filled with, and where.

    `members` has name, type, count and byte offset of each member, the method's own last, whose values are
    `own`; `near` and `far` are the planes of the official projection.
    """
    model = packed.model
    members: list[list[Any]] = []
    for name in VIEW.names or ():
        dtype, offset = VIEW.fields[name][:2]  # type: ignore[index]
        count = int(np.prod(dtype.shape, dtype=int))
        members.append([name, _TYPES[dtype.base.kind], count, offset])
    offset = VIEW.itemsize
    for name, value in model.own.items():
        members.append([name, _TYPES[value.dtype.kind], 1, offset])
        offset += 4
    return {
        "members": members,
        "bytes": -(-offset // 16) * 16,
        "near": model.near,
        "far": model.far,
        "degree": packed.degree,
        "own": {name: value.item() for name, value in model.own.items()},
    }


def _live_settings(asset: Asset, settings: Mapping[str, Any], model: Model | Surface) -> list[dict[str, Any]]:
    """Return the settings of the method that change nothing but the camera record.

    Each has its `name`, its `value` and `options`: a value, and the record's members with it.
    """
    live = []
    values = effective_settings(asset.manifest, settings)
    for name, setting in lookup(asset.manifest.method).settings.items():
        choices = {"bool": (False, True), "choice": setting.choices}.get(setting.kind, ())
        options = []
        for choice in choices:
            try:
                other = make_native_model(asset, {**values, name: choice})
            except MsbError:
                break
            if not _alike(model, other):
                break
            options.append({"value": choice, "own": {key: value.item() for key, value in other.own.items()}})
        if len(options) == len(choices) > 1:
            live.append({"name": name, "value": values[name], "options": options})
    return live


def _alike(model: Model | Surface, other: Model | Surface) -> bool:
    """Return whether two models differ in the method's own members of the record at most."""
    for name, one in vars(model).items():
        two = getattr(other, name)
        if name == "projection":
            continue  # the page computes it, of the camera and `own`
        if name == "own":
            one, two = set(one), set(two)
        if not (np.array_equal(one, two) if isinstance(one, np.ndarray) else one == two):
            return False
    return True


def _seen_sphere(asset: Asset) -> dict[str, Any]:
    """Return what a free camera looks at: the bounding sphere, or less where a few faces are far away.

    A capture has such faces, and to turn about the middle of their box would turn it out of view.
    """
    whole = asset.manifest.bounding_sphere
    positions = np.asarray(asset.buffers["positions"][:: max(1, asset.manifest.vertex_count // 100_000)])
    middle = np.median(positions, axis=0)
    radius = float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.9))
    if whole.radius < 3 * radius:
        return {"center": list(whole.center), "radius": whole.radius}
    return {"center": middle.tolist(), "radius": radius}


def _needed(buffers: Iterable[tuple[int, tuple[str, ...]]], most: int, guaranteed: int) -> int:
    """Return the limit that a page asks for."""
    return min(most, max(guaranteed, *(size for size, _ in buffers)))


def _keep_positions(
    asset: Asset,
    packed: Packed,
    keep: Callable[..., str],
    kept: dict[str, tuple[dict[str, Any], bytes]],
) -> None:
    """Keep the positions as stored, and those of the plan as what makes them of these, if that is exact.

    2DTS shrinks its triangles about their centroids, after which they no longer lie on the grid that
    rounded positions have.
    """
    whole, drawn = np.asarray(asset.buffers["positions"], np.float32), packed.arrays["positions"]
    if np.array_equal(whole, drawn):
        keep("positions", drawn)
        return
    factor = _shrink_factor(whole, drawn) if packed.soup and whole.shape == drawn.shape else None
    if factor is None:
        keep("positions", drawn)
        if len(whole) != len(drawn):  # the corners of a soup, whose faces share rows as stored
            return
    keep("stored positions", whole)
    if factor is not None:
        kept["positions"] = {"shrunk": {"of": "stored positions", "factor": factor}}, b""


def _shrink_factor(whole: NDArray[np.float32], drawn: NDArray[np.float32]) -> float | None:
    """Return by what float32 all triangles, rows of three corners, were shrunk; None if by none."""
    triangles, others = whole.reshape(-1, 3, 3), drawn.reshape(-1, 3, 3)
    center = ((triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / np.float32(3))[:, None]
    arms = triangles - center
    largest = np.unravel_index(np.abs(arms).argmax(), arms.shape)
    if arms[largest] == 0:
        return None
    guess = np.float32((others - center)[largest] / arms[largest])
    near = guess + np.arange(-64, 65) * np.spacing(guess)
    for factor in sorted(near.astype(np.float32), key=lambda one: abs(float(one) - float(guess))):
        few = slice(0, 64)
        if np.array_equal(arms[few] * factor + center[few], others[few]) and np.array_equal(
            arms * factor + center, others
        ):
            return float(factor)
    return None


def _standard(
    asset: Asset,
    packed: Packed,
    values: Mapping[str, Any],
    keep: Callable[..., str],
    kept: Mapping[str, Any],
) -> dict[str, Any]:
    """Return which arrays are the mesh of the standard tier, in grey if the method has no static colour."""
    grey = not lookup(asset.manifest.method).supports("standard")
    numbers = None if grey else shown_faces(asset, values.get("ste_threshold"))
    shown = None
    if numbers is not None:
        mask = np.zeros(packed.faces, np.uint8)
        mask[numbers] = 1
        shown = keep("shown faces", mask)
    return {
        "positions": "stored positions" if "stored positions" in kept else "positions",
        "indices": None if packed.soup else "indices",
        "colors": "f_dc" if "f_dc" in packed.arrays and colors_of(asset) is not None else None,
        "shown": shown,
        "soup": packed.soup,
        "grey": grey,
    }


def _elements(arrays: Iterable[tuple[str, bytes]]) -> Iterable[str]:
    """Yield elements with the base64 of arrays, whole groups of four letters in each."""
    for name, data in arrays:
        for start in range(0, len(data), _LETTERS // 4 * 3):
            text = base64.b64encode(data[start : start + _LETTERS // 4 * 3]).decode("ascii")
            yield f'<script type="text/plain" data-array="{name}">{text}</script>'


def read_page(path: Path) -> tuple[bytes, dict[str, Any], list[NDArray[np.uint8]]]:
    """Return the bytes of a page, its scene, and the images of its test views, (H, W, 3)."""
    data = read_file(path)
    try:
        element = _SCENE.search(data)
        text = element[1] if element else b""
        scene = parse_strict_json(text, file=path, name="the scene", max_bytes=len(text))
        images = _test_images(data, scene["dedicated"])
    except Exception as error:
        text = "it is no page that msb web --tier dedicated wrote"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path) from error
    return data, scene, images


def _test_images(page: bytes, about: Mapping[str, Any]) -> list[NDArray[np.uint8]]:
    shapes = [(test["view"]["height"], test["view"]["width"], 3) for test in about["tests"]]
    if not all(type(side) is int and side > 0 for shape in shapes for side in shape):
        raise ValueError("a test view without pixels")
    sizes = [math.prod(shape) for shape in shapes]
    if sum(sizes) > _MOST_OF_TESTS:  # a few bytes of zlib can stand for a thousand times as many
        raise ValueError(f"test views of {sum(sizes)} bytes")
    streams = {test["image"]: b"" for test in about["tests"]}
    for part in _ARRAY.finditer(page):
        name = part[1].decode()
        if name in streams:
            streams[name] += base64.b64decode(part[2])
    images = []
    for test, shape, size in zip(about["tests"], shapes, sizes, strict=True):
        head = about["arrays"][test["image"]]
        if (head["how"], head["type"], head["bytes"]) != ("plain", "uint8", size):
            raise ValueError(f"an image of {size} bytes is {head}")
        images.append(restore(head, streams[test["image"]]).reshape(shape))
    return images
