"""The page of the dedicated tier: an HTML file with the arrays of an asset and the plans of its frames."""

import base64
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import colors_of, select_faces
from msb.asset.settings import effective_settings
from msb.asset.strict_json import parse_strict_json
from msb.base.files import read_file
from msb.engines.dedicated_page.storage import restore, store
from msb.engines.hardware.packing import VIEW, Packed, make_native_model, pack
from msb.engines.hardware.plan import Limits, Plan
from msb.engines.hardware.program import make_plan
from msb.engines.webpage import camera_to_json, fill_template, scene_to_json
from msb.errors import DeviceError, InputError, MsbError
from msb.registry import Order, Sampling, lookup
from msb.render.splat.model import SplatModel
from msb.render.surface import Surface
from msb.scenes import Camera
from msb.scenes.colors import Color
from msb.scenes.framing import find_framing

SCRIPTS = (
    *("camera.js", "page.js", "controls.js", "store.js", "dedicated.js"),
    *("native.js", "quality.js", "start.js"),
)
# The limits that WebGPU guarantees on every device.
_GUARANTEED = Limits(binding=1 << 27, buffer=1 << 28, side=8192)
# Limits of most desktop graphics cards. The page requests the limits that it needs, and reports an error if
# the limits of the device are lower.
_LARGER = Limits(binding=1 << 30, buffer=1 << 31, side=8192)
# Number of face chunks, which are blended one after the other (see `program.STOPS`). The page has fewer
# chunks than the renderer, because the pass before each chunk reads all samples, which is slow in browsers.
STOPS = 8
# The combinations of face order and sampling that a page offers.
MODES: tuple[tuple[Order, Sampling], ...] = (
    *(("tile", "official"), ("global", "official"), ("none", "official")),
    *(("tile", "engine"), ("none", "engine")),  # game engines have no tiles, so "global" is omitted
)
# The WGSL type for each NumPy kind of a uniform buffer member.
_TYPES = {"f": "f32", "i": "i32", "u": "u32"}
# Maximum number of base64 letters in an HTML element.
_LETTERS = 1 << 23
# Maximum total size in bytes of the test images that are read from a page.
_MAX_TEST_BYTES = 1 << 30
_ARRAY = re.compile(rb'<script type="text/plain" data-array="([^"]*)">([^<]*)</script>')
_SCENE = re.compile(rb'<script type="application/json" id="scene">(.*?)</script>', re.DOTALL)


def psnr_to_json(value: float) -> float | None:
    """Return a PSNR for JSON; None means that the images are equal."""
    return None if math.isinf(value) else value


@dataclass(frozen=True)
class CheckView:
    """A test view of a page, with its expected image (H, W, 3) uint8."""

    camera: Camera
    background: Color
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class Cost:
    """A reduction of the asset: its description, and the lowest PSNR in dB against the full asset."""

    what: str
    psnr: float


@dataclass(frozen=True)
class BakedMesh:
    """A mesh that was baked from the model, as GLB in the coordinates of the model, with stored colours.

    `psnr` is the average PSNR in dB of the baked mesh on the test views, with one sample per pixel. `plain`
    is the average PSNR of the model's standard-tier mesh, or None without such a mesh.
    """

    glb: bytes
    psnr: float
    plain: float | None


@dataclass
class DedicatedPage:
    """The content of a page: its scene (JSON data), its arrays (HTML elements) and a baked mesh (GLB).

    After `record` has added a measurement, call `to_bytes` again.
    """

    scene: dict[str, Any]
    arrays: str = field(repr=False)
    glb: bytes = field(default=b"", repr=False)

    def to_bytes(self) -> bytes:
        """Return the page as an HTML file."""
        encoded = base64.b64encode(self.glb).decode("ascii")
        return fill_template(self.scene, SCRIPTS, glb=encoded, arrays=self.arrays)

    def record(self, by: str, psnr: Sequence[float]) -> None:
        """Add a measurement: the PSNR in dB of each test view, and the name of the browser."""
        self.scene["dedicated"]["measured"] = {"by": by, "psnr": list(map(psnr_to_json, psnr))}


class _Arrays:
    """The compressed arrays of a page. Each array has a name, a head (JSON data) and a zlib stream."""

    def __init__(self) -> None:
        self.entries: dict[str, tuple[dict[str, Any], bytes]] = {}

    def add(self, name: str, array: NDArray[Any]) -> str:
        """Compress an array and return the array's name."""
        stored = store(array)
        self.entries[name] = stored.head, stored.data
        return name

    def add_positions(self, asset: Asset, packed: Packed) -> None:
        """Add the positions of the asset and the positions of the plan. 2DTS plans have shrunk positions.

        2DTS shrinks triangles about their centroids. Shrunk positions compress badly, because they are not on
        a regular grid. If the page can compute the shrunk positions exactly, only the shrink factor is
        stored.
        """
        stored = np.asarray(asset.buffers["positions"], np.float32)
        plan_positions = packed.arrays["positions"]
        if np.array_equal(stored, plan_positions):
            self.add("positions", plan_positions)
            return
        may_be_shrunk = packed.soup and stored.shape == plan_positions.shape
        factor = _shrink_factor(stored, plan_positions) if may_be_shrunk else None
        if factor is None:
            self.add("positions", plan_positions)
            if len(stored) != len(
                plan_positions
            ):  # the asset shares vertices, but the plan duplicates these vertices
                return
        self.add("stored positions", stored)
        if factor is not None:
            self.entries["positions"] = {"shrunk": {"of": "stored positions", "factor": factor}}, b""

    def to_html(self) -> str:
        """Return HTML elements with the streams in base64; long streams are split between elements."""
        elements = []
        size = _LETTERS // 4 * 3
        for name, (_, data) in self.entries.items():
            for start in range(0, len(data), size):
                text = base64.b64encode(data[start : start + size]).decode("ascii")
                elements.append(f'<script type="text/plain" data-array="{name}">{text}</script>')
        return "\n".join(elements)


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
    baked: BakedMesh | None = None,
) -> DedicatedPage:
    """Return the page of an asset.

    Parameters
    ----------
    asset : Asset
        The asset, which may be reduced.
    name, cameras, up, background : see `webpage.scene_to_json`
    settings : mapping
        Settings that replace the settings in the asset.
    tests : sequence of CheckView
        The test views.
    against : str
        The source of the images in the test views.
    costs : sequence of Cost
        The reductions that were applied to `asset`, with their losses.
    all_faces : int, optional
        Number of faces before the reductions.
    baked : BakedMesh, optional
        A baked mesh to show beside the model.

    Raises
    ------
    Unsupported
        UNSUPPORTED_TIER: the method has no WGSL.
    DeviceError
        DEVICE_MEMORY: the asset is too large for WebGPU.
    """
    # Prefer a plan within the limits of all devices. Larger assets need the higher limits of a graphics card.
    packed = pack(asset, settings)
    try:
        limits = _GUARANTEED
        plans = _make_plans(packed, limits, "every browser")
    except DeviceError:
        limits = _LARGER
        plans = _make_plans(packed, limits, "WebGPU on most graphics cards")
    # Store the arrays of the first plan. Later plans refer to the arrays of the first plan, and only add
    # arrays that differ.
    arrays = _Arrays()
    first = plans[MODES[0]]
    for array_name, array in first.data.items():
        if array_name == "positions":
            arrays.add_positions(asset, packed)
        else:
            arrays.add(array_name, array)
    modules: list[str] = []
    records = []
    for (order, sampling), plan in plans.items():
        names = {}
        for buffer, array in plan.data.items():
            same = buffer in first.data and np.array_equal(array, first.data[buffer])
            names[buffer] = buffer if same else arrays.add(f"{buffer}, {order}, {sampling}", array)
        # The list `modules` stores equal WGSL texts once. A plan stores indices into the list `modules`.
        record = plan.record()
        modules += [text for text in record["modules"].values() if text not in modules]
        record["modules"] = {key: modules.index(text) for key, text in record["modules"].items()}
        records.append({"order": order, "sampling": sampling, "arrays": names, **record})
    buffers = [entry for plan in plans.values() for entry in plan.buffers.values()]
    values = effective_settings(asset.manifest, settings)
    standard = _describe_standard_mesh(asset, packed, values, arrays)
    test_entries = []
    for k, test in enumerate(tests):
        image = arrays.add(f"test {k}", test.image.reshape(-1, 3))
        test_entries.append(
            {
                "name": test.camera.name or str(k),
                "view": camera_to_json(test.camera),
                "background": list(test.background),
                "image": image,
            }
        )
    scene = scene_to_json(name, cameras, up, background)
    scene["dedicated"] = {
        "title": lookup(asset.manifest.method).title,
        "faces": packed.faces,
        "all_faces": all_faces or packed.faces,
        "plans": records,
        "modules": modules,
        "view": _describe_record(packed),
        "settings": _live_settings(asset, settings, packed.model),
        "needs": {
            "maxStorageBufferBindingSize": _required_limit(buffers, limits.binding, _GUARANTEED.binding),
            "maxBufferSize": _required_limit(buffers, limits.buffer, _GUARANTEED.buffer),
        },
        "arrays": {key: head for key, (head, _) in arrays.entries.items()},
        "standard": standard,
        "sphere": _orbit_sphere(asset),
        "tests": test_entries,
        "against": against,
        "measured": None,
        "costs": [{"what": cost.what, "psnr": psnr_to_json(cost.psnr)} for cost in costs],
        "baked": None if baked is None else {"psnr": baked.psnr, "plain": baked.plain},
    }
    return DedicatedPage(scene, arrays.to_html(), b"" if baked is None else baked.glb)


def _make_plans(packed: Packed, limits: Limits, name: str) -> dict[tuple[Order, Sampling], Plan]:
    """Return a plan for each mode of `MODES`, the official mode first.

    A model with a z-buffer only has modes with the order "tile", because the drawing order does not change
    its images.
    """
    plans = {}
    for order, sampling in MODES:
        if packed.surface is None or order == "tile":
            plans[order, sampling] = make_plan(
                packed, limits, name, order=order, sampling=sampling, stops=STOPS, depth=False
            )
    return plans


def _describe_record(packed: Packed) -> dict[str, Any]:
    """Return the layout of the uniform buffer for a camera. The page fills the uniform buffer for each frame.

    `members` describes each member of the buffer by name, type, number of values and byte offset. The
    method's members come last; their values are in `own`. `near` and `far` are the planes of the official
    projection.
    """
    model = packed.model
    members: list[list[Any]] = []
    for name in VIEW.names or ():
        dtype, offset = VIEW.fields[name][:2]  # type: ignore[index]
        count = int(np.prod(dtype.shape, dtype=int))
        members.append([name, _TYPES[dtype.base.kind], count, offset])
    offset = VIEW.itemsize
    for name, value in model.method_values.items():
        members.append([name, _TYPES[value.dtype.kind], 1, offset])
        offset += 4
    return {
        "members": members,
        "bytes": -(-offset // 16) * 16,
        "near": model.near,
        "far": model.far,
        "degree": packed.degree,
        "own": {name: value.item() for name, value in model.method_values.items()},
    }


def _live_settings(
    asset: Asset, settings: Mapping[str, Any], model: SplatModel | Surface
) -> list[dict[str, Any]]:
    """Return the settings that the page can change, because they only affect the camera's uniform buffer.

    Each setting has a `name`, the current `value` and a list `options`. Each option has a possible value and
    the buffer members that change with this value.
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
            if not _differ_in_record_only(model, other):
                break
            options.append(
                {"value": choice, "own": {key: value.item() for key, value in other.method_values.items()}}
            )
        if len(options) == len(choices) > 1:
            live.append({"name": name, "value": values[name], "options": options})
    return live


def _differ_in_record_only(model: SplatModel | Surface, other: SplatModel | Surface) -> bool:
    """Return whether two models are equal except for values in the camera's uniform buffer."""
    for name, value in vars(model).items():
        second = getattr(other, name)
        if name == "projection":
            continue  # the page computes the projection from the camera and the method's values
        if name == "method_values":
            value, second = set(value), set(second)
        if not (np.array_equal(value, second) if isinstance(value, np.ndarray) else value == second):
            return False
    return True


def _orbit_sphere(asset: Asset) -> dict[str, Any]:
    """Return the sphere that the free camera orbits. The sphere encloses the framed part of the model, or
    most of its vertices.

    In captured scenes, a few faces are far away from all others. An orbit around the whole bounding sphere
    would be too far from the model.
    """
    whole = find_framing(asset)
    positions = np.asarray(asset.buffers["positions"][:: max(1, asset.manifest.vertex_count // 100_000)])
    # The sphere around the median that contains 90 % of the sampled vertices.
    middle = np.median(positions, axis=0)
    radius = float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.9))
    if whole.radius < 3 * radius:
        return {"center": list(whole.center), "radius": whole.radius}
    return {"center": middle.tolist(), "radius": radius}


def _required_limit(buffers: Iterable[tuple[int, tuple[str, ...]]], maximum: int, guaranteed: int) -> int:
    """Return the limit to request from the device: the largest buffer size, but at least `guaranteed` and at
    most `maximum`."""
    return min(maximum, max(guaranteed, *(size for size, _ in buffers)))


def _shrink_factor(stored: NDArray[np.float32], plan_positions: NDArray[np.float32]) -> float | None:
    """Return the float32 factor by which triangles were shrunk about their centroids, or None.

    Both arrays are (3F, 3), with three consecutive rows per triangle.
    """
    triangles, shrunk = stored.reshape(-1, 3, 3), plan_positions.reshape(-1, 3, 3)
    center = ((triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / np.float32(3))[:, None]
    arms = triangles - center  # vectors from the centroids to the corners
    largest = np.unravel_index(np.abs(arms).argmax(), arms.shape)
    if arms[largest] == 0:
        return None
    # Estimate the factor from the longest vector to a corner. Try the float32 values around the estimate,
    # nearest first.
    guess = np.float32((shrunk - center)[largest] / arms[largest])
    near = guess + np.arange(-64, 65) * np.spacing(guess)
    sample = slice(0, 64)  # testing a few triangles first is faster
    for factor in sorted(near.astype(np.float32), key=lambda value: abs(float(value) - float(guess))):
        if np.array_equal(arms[sample] * factor + center[sample], shrunk[sample]) and np.array_equal(
            arms * factor + center, shrunk
        ):
            return float(factor)
    return None


def _describe_standard_mesh(
    asset: Asset, packed: Packed, values: Mapping[str, Any], arrays: _Arrays
) -> dict[str, Any]:
    """Describe the standard-tier mesh for the page, by the names of the mesh arrays.

    `grey` is true if the method has no static colours. `shown` is the array that marks the selected faces, or
    None if all faces are selected.
    """
    grey = not lookup(asset.manifest.method).supports("standard")
    numbers = None if grey else select_faces(asset, values.get("ste_threshold"))
    selected = None
    if numbers is not None:
        mask = np.zeros(packed.faces, np.uint8)
        mask[numbers] = 1
        selected = arrays.add("shown faces", mask)
    return {
        "positions": "stored positions" if "stored positions" in arrays.entries else "positions",
        "indices": None if packed.soup else "indices",
        "colors": "f_dc" if "f_dc" in packed.arrays and colors_of(asset) is not None else None,
        "shown": selected,
        "soup": packed.soup,
        "grey": grey,
    }


def read_page(path: Path) -> tuple[bytes, dict[str, Any], list[NDArray[np.uint8]]]:
    """Return the bytes of a page, its scene description, and the expected images (H, W, 3) of its test views.

    Raises
    ------
    InputError
        FILE_NOT_RECOGNISED: the file is not a page of the dedicated tier.
    """
    data = read_file(path)
    try:
        element = _SCENE.search(data)
        text = element[1] if element else b""
        scene = parse_strict_json(text, file=path, name="the scene", max_bytes=len(text))
        images = _read_test_images(data, scene["dedicated"])
    except Exception as error:
        text = "the file is not a page written by msb web --tier dedicated"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path) from error
    return data, scene, images


def _read_test_images(page: bytes, content: Mapping[str, Any]) -> list[NDArray[np.uint8]]:
    """Return the images of the test views; raise ValueError if they do not match the description."""
    shapes = [(test["view"]["height"], test["view"]["width"], 3) for test in content["tests"]]
    if not all(type(side) is int and side > 0 for shape in shapes for side in shape):
        raise ValueError("a test view has no pixels")
    sizes = [math.prod(shape) for shape in shapes]
    if sum(sizes) > _MAX_TEST_BYTES:  # limit the size, because a short stream can inflate to a huge image
        raise ValueError(f"the test views have {sum(sizes)} bytes")
    # Join the streams that are split between elements.
    streams = {test["image"]: b"" for test in content["tests"]}
    for part in _ARRAY.finditer(page):
        name = part[1].decode()
        if name in streams:
            streams[name] += base64.b64decode(part[2])
    images = []
    for test, shape, size in zip(content["tests"], shapes, sizes, strict=True):
        head = content["arrays"][test["image"]]
        if (head["how"], head["type"], head["bytes"]) != ("plain", "uint8", size):
            raise ValueError(f"an image of {size} bytes has the unexpected head {head}")
        images.append(restore(head, streams[test["image"]]).reshape(shape))
    return images
