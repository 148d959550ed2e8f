"""The passes and buffers of a frame as plain data, which wgpu-py and a browser's WebGPU run alike."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.engines.hardware.packing import VIEW
from msb.engines.hardware.wgsl import as_attributes, assemble, face_members
from msb.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.engines.hardware.packing import Packed
    from msb.methods import Order, Sampling

SLOT = 256
"""Bytes between entries of a uniform buffer that are bound one at a time."""
_GROUP = 64
"""Invocations of a work-group of the stages over faces."""
_MOST_GROUPS = 65535
"""Work-groups along an axis: what WebGPU guarantees."""
_BLOCK = 2048
"""Items of a work-group of the sort; equals BLOCK in sort.wgsl."""
_DIGIT_BITS = 4
_KEY_BITS = 32
_TYPES = {"float32": "f32", "int32": "i32", "uint32": "u32"}


@dataclass(frozen=True)
class Binding:
    """A part of a buffer, or a texture, at a number of group 0.

    `kind` is "uniform", "read", "write" or "texture". `per_band` says that `offset` is that of the band.
    """

    number: int
    kind: str
    name: str
    offset: int = 0
    size: int | None = None
    per_band: bool = False


@dataclass(frozen=True)
class Compute:
    """A dispatch: `groups` work-groups, or as many as `arguments` says at a byte offset (`indirect`).

    A dispatch of a band has a work-item for each pixel, by columns of 64 (`groups` None).
    """

    stage: str
    module: str
    entry: str
    bindings: tuple[Binding, ...]
    groups: int | None = None
    indirect: int | None = None


@dataclass(frozen=True)
class Draws:
    """A render pass: for each buffer of records a draw, whose numbers `arguments` has at an offset."""

    stage: str
    module: str
    bindings: tuple[Binding, ...]
    targets: tuple[str, ...]
    records: tuple[tuple[str, int], ...]
    members: int
    """vec4 of a record: attributes at locations 0, 1, ..."""


@dataclass(frozen=True)
class Plan:
    """What a frame is made of.

    Attributes
    ----------
    modules : mapping
        Name -> WGSL.
    buffers : mapping
        Name -> bytes and usages. What `data` holds is uploaded once.
    data : mapping
        Name -> array.
    passes, band_passes : tuple
        Once a frame, and once for each band of it.
    format : str
        Of the targets `image` and `depth`, whose sizes are those of a band in samples.
    scale : int
        Samples of a pixel along each axis.
    """

    modules: Mapping[str, str]
    buffers: Mapping[str, tuple[int, tuple[str, ...]]]
    data: Mapping[str, NDArray[Any]]
    passes: tuple[Compute, ...]
    band_passes: tuple[Draws | Compute, ...]
    format: str
    scale: int

    def record(self) -> dict[str, Any]:
        """Return all but `data` as JSON takes it: what a page in a browser runs."""
        return {key: value for key, value in asdict(replace(self, data={})).items() if key != "data"}


@dataclass(frozen=True)
class Limits:
    """What a device takes: bytes of a storage binding and of a buffer, and texels of a target's side."""

    binding: int
    buffer: int
    side: int


class _Planner:
    """Collects buffers and passes of a plan."""

    def __init__(self, packed: Packed, limits: Limits, name: str) -> None:
        self.packed, self.limits, self.name = packed, limits, name
        self.buffers: dict[str, tuple[int, tuple[str, ...]]] = {}
        self.data: dict[str, NDArray[Any]] = {}
        self.parts: list[tuple[int, int]] = []
        self.soup = not packed.model.vertex_colors

    def buffer(self, name: str, size: int, *usages: str) -> None:
        size = max(-(-size // 16) * 16, 16)
        limit = min(self.limits.binding, self.limits.buffer) if "storage" in usages else self.limits.buffer
        if size > limit:
            text = f"{self.name} takes buffers of {limit} bytes, {name} of this asset need {size}"
            raise DeviceError("DEVICE_MEMORY", text, value=size, limit=limit)
        self.buffers[name] = size, usages

    def upload(self, name: str, array: NDArray[Any], usage: str = "storage") -> None:
        self.buffer(name, array.nbytes, usage, "copy_dst")
        self.data[name] = array

    def part(self, first: int, count: int) -> Binding:
        """Return the binding that tells a stage which rows it has."""
        self.parts.append((first, count))
        return Binding(1, "uniform", "parts", SLOT * (len(self.parts) - 1), 16)

    def model(self) -> list[Binding]:
        """Return the bindings of what every projecting stage reads."""
        names = {2: "positions", 3: "indices", 4: "coverage"}
        if self.soup:
            del names[3]
        return [VIEW_BINDING, *(Binding(number, "read", name) for number, name in names.items())]


VIEW_BINDING = Binding(0, "uniform", "view")


def make_plan(
    packed: Packed,
    limits: Limits,
    name: str,
    *,
    order: Order = "tile",
    sampling: Sampling = "official",
    form: str = "rgba32float",
    depth: bool = True,
    debug: bool = False,
) -> Plan:
    """Return how a frame of an asset is drawn.

    Parameters
    ----------
    packed : Packed
    limits : Limits
    name : str
        Of the device, for messages.
    order, sampling : str
        As on the dedicated tier in OpenCL.
    form : str
        The format of the targets that are blended into.
    depth : bool
        Whether depth is drawn, too.
    debug : bool
        Whether the tile rectangles are kept, in the buffer `rectangles`.

    Raises
    ------
    DeviceError
        `DEVICE_MEMORY`: an array does not fit into a buffer of the device.
    """
    model, planner = packed.model, _Planner(packed, limits, name)
    defines: dict[str, bool | int | str] = {
        **{key: bool(value) for key, value in model.defines.items()},
        "OWN_MEMBERS": "\n".join(f"    {k}: {_TYPES[v.dtype.name]}," for k, v in model.own.items()),
        "VERTEX_COLORS": model.vertex_colors,
        "ENGINE": sampling == "engine",
        "IN_TILES": order == "tile" and sampling == "official",
        "DEPTH": depth,
        "DEBUG": debug,
        "REST_STRIDE": packed.rest_stride,
        "SCALE": model.scale,
        "FIRST_SAMPLE": 0 if model.box_mean else (model.scale - 1) // 2,
        "LAST_SAMPLE": model.scale - 1 if model.box_mean else model.scale // 2,
    }
    own = f"{model.program}.wgsl"

    def text(*files: str, **more: bool | int | str) -> str:
        return assemble(files, model.package, {**defines, **more})

    plain = text(own)
    members = face_members(plain)
    record_bytes = 16 * len(members)
    modules = {
        "project": text(own, "project.wgsl", COMPUTE=True, KEYING=True, COLORING=planner.soup),
        "record": text(own, "project.wgsl", COMPUTE=True, RECORDING=True),
        "sort first": text("sort.wgsl", FIRST=True),
        "sort": text("sort.wgsl"),
        "draw": as_attributes(text(own, "draw.wgsl", **_between(members)), members),
        "resolve": text("resolve.wgsl"),
    }
    if not planner.soup:
        modules["shade"] = text(own, "project.wgsl", COMPUTE=True, COLORING=True, SHADING=True)
    passes = [*_projection(planner, debug), *_sorting(planner, order, record_bytes)]
    ranges = _record_ranges(planner, record_bytes)
    last = "faces a" if order == "none" else "faces b"
    records = []
    for k, (first, count) in enumerate(ranges):
        planner.buffer(f"records {k}", count * record_bytes, "storage", "vertex")
        bindings = [
            *planner.model(),
            planner.part(first, count),
            Binding(8, "read", "colors"),
            Binding(10, "read", last),
            Binding(11, "read", "arguments"),
            Binding(12, "write", f"records {k}"),
        ]
        passes.append(Compute("records", "record", "record", tuple(bindings), indirect=4 * (4 + 7 * k)))
        records.append((f"records {k}", 4 * (7 + 7 * k)))
    own_bytes = 4 * len(model.own)
    planner.buffer("view", VIEW.itemsize + own_bytes, "uniform", "copy_dst")
    planner.upload("parts", _slots(np.array(planner.parts, np.uint32)), "uniform")
    band = Binding(1, "uniform", "bands", 0, 32, per_band=True)
    targets = ("image", "depth") if depth else ("image",)
    textures = tuple(Binding(2 + k, "texture", target) for k, target in enumerate(targets))
    pixels = Binding(4, "write", "pixels", per_band=True)
    return Plan(
        modules=modules,
        buffers=planner.buffers,
        data=planner.data,
        passes=tuple(passes),
        band_passes=(
            Draws("blend", "draw", (VIEW_BINDING, band), targets, tuple(records), len(members)),
            Compute("resolve", "resolve", "resolve", (VIEW_BINDING, band, *textures, pixels)),
        ),
        format=form,
        scale=model.scale,
    )


def _between(members: list[str]) -> dict[str, str]:
    """Return what draw.wgsl needs to hand a record on from the vertex stage to the fragments."""
    return {
        "BETWEEN_MEMBERS": "\n".join(
            f"    @location({k}) @interpolate(flat) {name}: vec4<f32>," for k, name in enumerate(members)
        ),
        "BETWEEN_COPIES": "\n".join(f"    between.{name} = face.{name};" for name in members),
        "FACE_VALUES": ", ".join(f"between.{name}" for name in members),
    }


def _projection(planner: _Planner, debug: bool) -> list[Compute]:
    """Return the passes that give every face its key, and faces or vertices their colours."""
    packed = planner.packed
    for name, array in packed.arrays.items():
        if name != "f_rest":
            planner.upload(name, array)
    colored = packed.faces if planner.soup else packed.vertices
    planner.buffer("keys", 4 * packed.faces, "storage", "copy_src")
    planner.buffer("colors", 12 * colored, "storage")
    if debug:
        planner.buffer("rectangles", 16 * packed.faces, "storage", "copy_src")
    found: list[Compute] = []
    keys = [Binding(7, "write", "keys"), *([Binding(9, "write", "rectangles")] if debug else [])]
    room = planner.limits.binding // max(4 * packed.rest_stride, 1)
    parts = _ranges(colored, min(room, _GROUP * _MOST_GROUPS))
    for first, count in parts:
        name = "f_rest" if len(parts) == 1 else f"f_rest {len(found)}"
        rest = packed.arrays["f_rest"]
        planner.upload(name, rest[first : first + count] if packed.rest_stride else rest)
        bindings = [
            *planner.model(),
            planner.part(first, count),
            Binding(5, "read", "f_dc"),
            Binding(6, "read", name),
            Binding(8, "write", "colors"),
            *(keys if planner.soup else []),
        ]
        module, entry = ("project", "project") if planner.soup else ("shade", "shade_vertices")
        found.append(Compute("project", module, entry, tuple(bindings), -(-count // _GROUP)))
    if not planner.soup:
        for first, count in _ranges(packed.faces, _GROUP * _MOST_GROUPS):
            bindings = [*planner.model(), planner.part(first, count), *keys]
            found.append(Compute("project", "project", "project", tuple(bindings), -(-count // _GROUP)))
    return found


def _sorting(planner: _Planner, order: Order, record_bytes: int) -> list[Compute]:
    """Return the passes of the radix sort; order "none" needs its first one alone, which drops faces."""
    faces = planner.packed.faces
    blocks = max(-(-faces // _BLOCK), 1)
    ranges = _record_ranges(planner, record_bytes)
    for name in ("keys a", "keys b", "faces a", "faces b"):
        planner.buffer(name, 4 * faces, "storage")
    planner.buffer("sums", 4 * (1 << _DIGIT_BITS) * blocks, "storage")
    planner.buffer("arguments", 4 * (4 + 7 * len(ranges)), "storage", "indirect", "copy_src")
    mask = 0 if order == "none" else (1 << _DIGIT_BITS) - 1
    shifts = [0] if order == "none" else list(range(0, _KEY_BITS, _DIGIT_BITS))
    most = ranges[0][1] if ranges else 1
    steps = [(shift, mask, faces, blocks, len(ranges), most, 0, 0) for shift in shifts]
    planner.upload("steps", _slots(np.array(steps, np.uint32)), "uniform")
    found = []
    for k in range(len(shifts)):
        source, target = ("b", "a") if k % 2 == 0 else ("a", "b")
        step = Binding(0, "uniform", "steps", SLOT * k, 32)
        keys = Binding(1, "read", f"keys {source}" if k else "keys")
        sums, told = Binding(5, "write", "sums"), Binding(6, "read" if k else "write", "arguments")
        moved = [Binding(3, "write", f"keys {target}"), Binding(4, "write", f"faces {target}")]
        if k:
            moved.append(Binding(2, "read", f"faces {source}"))
        module = "sort" if k else "sort first"
        size: dict[str, Any] = {"indirect": 4} if k else {"groups": blocks}
        found += [
            Compute("sort", module, "count", (step, keys, sums, told), **size),
            Compute("sort", module, "scan", (step, sums, told), groups=1),
            Compute("sort", module, "place", (step, keys, sums, told, *moved), **size),
        ]
    return found


def _record_ranges(planner: _Planner, record_bytes: int) -> list[tuple[int, int]]:
    """Return first and count of the places of each buffer of records."""
    room = min(planner.limits.binding, planner.limits.buffer) // record_bytes // _GROUP * _GROUP
    return _ranges(planner.packed.faces, min(room, _GROUP * _MOST_GROUPS))


def _ranges(count: int, most: int) -> list[tuple[int, int]]:
    return [(first, min(most, count - first)) for first in range(0, count, most)]


def _slots(rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return rows of a uniform buffer, each in a slot of its own."""
    found = np.zeros((max(len(rows), 1), SLOT // 4), np.uint32)
    if len(rows):
        found[:, : rows.shape[1]] = rows
    return found
