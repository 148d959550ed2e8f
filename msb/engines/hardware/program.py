"""The plan of an asset's frame: its texts of WGSL, its buffers, and the passes that use them."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.engines.hardware.packing import VIEW, Packed
from msb.engines.hardware.plan import SLOT, Binding, Compute, Draws, Limits, Plan
from msb.engines.hardware.wgsl import as_attributes, assemble, face_members
from msb.errors import DeviceError
from msb.registry import Order, Sampling
from msb.render.surface import Surface

# Invocations of a work-group of the stages over faces.
_GROUP = 64
# Work-groups along an axis: what WebGPU guarantees.
_MOST_GROUPS = 65535
# Items of a work-group of the sort.
_BLOCK = 2048
_DIGIT_BITS = 4
_KEY_BITS = 32
# Chunks in which faces are blended where a method refuses the face that crosses its threshold.
STOPS = 32
_REFUSES = re.compile(r"^const STOP = ", re.MULTILINE)
_TYPES = {"float32": "f32", "int32": "i32", "uint32": "u32"}


class _Planner:
    """Collects buffers and passes of a plan."""

    def __init__(self, packed: Packed, limits: Limits, name: str) -> None:
        self.packed, self.limits, self.name = packed, limits, name
        self.buffers: dict[str, tuple[int, tuple[str, ...]]] = {}
        self.data: dict[str, NDArray[Any]] = {}
        self.parts: list[tuple[int, int]] = []

    def buffer(self, name: str, size: int, *usages: str) -> None:
        size = max(-(-size // 16) * 16, 16)
        limit = self.limits.storage if "storage" in usages else self.limits.buffer
        if size > limit:
            text = f"{self.name} takes buffers of {limit} bytes, {name} of this asset need {size}"
            raise DeviceError("DEVICE_MEMORY", text)
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
        if self.packed.soup:
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
    stops: int = STOPS,
    depth: bool = True,
    debug: bool = False,
) -> Plan:
    """Return how a frame of an asset is drawn on the device `name`; order and sampling are as in OpenCL.

    `form` is the format of the targets that are blended into. Where the method refuses the face that crosses
    its threshold, faces are blended in so many chunks (`stops`; 1 leaves that rule out). With `debug` the
    tile rectangles are kept, in the buffer `rectangles`.
    """
    model, planner = packed.model, _Planner(packed, limits, name)
    surface = packed.surface
    lattices: dict[str, bool | int | str] = {}
    if surface is not None:
        order, form = "none", "r32uint"  # a z-buffer has no order, and numbers of faces are its targets
        as_bytes = surface.features.dtype == np.uint8
        lattices = {"SIDE": 1 << surface.level, "BYTES": as_bytes, "TEXEL": "u32" if as_bytes else "f32"}
    defines: dict[str, bool | int | str] = {
        **{key: bool(value) for key, value in packed.defines.items()},
        "OWN_MEMBERS": "\n".join(f"    {k}: {_TYPES[v.dtype.name]}," for k, v in model.own.items()),
        "VERTEX_COLORS": not packed.soup,
        "ENGINE": sampling == "engine",
        "IN_TILES": order == "tile" and sampling == "official" and surface is None,
        "DEPTH": depth,
        "DEBUG": debug,
        "Z_BUFFER": surface is not None,
        **lattices,
        "REST_STRIDE": packed.rest_stride,
        "SCALE": packed.scale,
        "FIRST_SAMPLE": packed.pixel_samples[0],
        "LAST_SAMPLE": packed.pixel_samples[1],
    }
    own = f"{model.program}.wgsl"
    chunks = stops if _REFUSES.search(assemble([own], model.package, defines)) else 1
    defines["STOPS"] = chunks > 1

    def text(*files: str, **more: bool | int | str) -> str:
        return assemble(files, model.package, {**defines, **more})

    plain = text(own)
    members = face_members(plain)
    record_bytes = 16 * len(members)
    modules = {
        "project": text(own, "project.wgsl", COMPUTE=True, KEYING=True, COLORING=packed.soup),
        "record": text(own, "project.wgsl", COMPUTE=True, RECORDING=True),
        "sort first": text("sort.wgsl", FIRST=True, BLOCK=_BLOCK),
        "sort": text("sort.wgsl", BLOCK=_BLOCK),
        "draw": as_attributes(text(own, "draw.wgsl", **_between(members)), members),
        "resolve": text("resolve.wgsl"),
    }
    if chunks > 1:
        modules["hold"] = text("hold.wgsl")
    if surface is not None:
        modules["decode"] = text(own, "surface.wgsl", COMPUTE=True, DECODING=True)
        del modules["resolve"]
    elif not packed.soup:
        modules["shade"] = text(own, "project.wgsl", COMPUTE=True, COLORING=True, SHADING=True)
    parts, room = _record_parts(planner, record_bytes, chunks)
    passes = [*_projection(planner, debug), *_sorting(planner, order, chunks, parts)]
    last = "faces a" if order == "none" else "faces b"
    records = []
    for k in range(chunks * parts):
        planner.buffer(f"records {k}", room * record_bytes, "storage", "vertex")
        start = 4 + 8 * k  # in `arguments`
        bindings = [
            *planner.model(),
            planner.part(start, room),
            Binding(8, "read", "colors") if surface is None else Binding(7, "write", "keys"),
            Binding(10, "read", last),
            Binding(11, "read", "arguments"),
            Binding(12, "write", f"records {k}"),
        ]
        passes.append(Compute("records", "record", "record", tuple(bindings), indirect=4 * start))
        records.append((f"records {k}", 4 * (start + 4)))
    own_bytes = 4 * len(model.own)
    planner.buffer("view", VIEW.itemsize + own_bytes, "uniform", "copy_dst")
    if surface is not None:
        band_passes = _z_buffered(planner, surface, tuple(records), len(members))
    else:
        targets = ("image", "depth") if depth else ("image",)
        band_passes = _blended(targets, tuple(records), len(members), chunks)
    planner.upload("parts", _slots(np.array(planner.parts, np.uint32)), "uniform")
    return Plan(
        modules=modules,
        buffers=planner.buffers,
        data=planner.data,
        passes=tuple(passes),
        band_passes=band_passes,
        format=form,
        scale=packed.scale,
    )


_BAND = Binding(1, "uniform", "bands", 0, 32, per_band=True)
_PIXELS = Binding(4, "write", "pixels", per_band=True)


def _blended(
    targets: tuple[str, ...], records: tuple[tuple[str, int], ...], members: int, chunks: int
) -> tuple[Draws | Compute, ...]:
    """Return the passes of a band that blend faces and turn samples into pixels."""
    textures = tuple(Binding(2 + k, "texture", target) for k, target in enumerate(targets))
    resolve = Compute("resolve", "resolve", "resolve", (VIEW_BINDING, _BAND, *textures, _PIXELS))
    if chunks == 1:
        return Draws("blend", "draw", (VIEW_BINDING, _BAND), targets, records, members), resolve
    held = (_BAND, Binding(2, "texture", "image"), Binding(3, "store", "covered"))
    bound = (VIEW_BINDING, _BAND, Binding(2, "texture", "covered"))
    parts = len(records) // chunks
    steps: list[Draws | Compute] = []
    for k in range(chunks):
        here = records[k * parts : (k + 1) * parts]
        steps.append(Compute("blend", "hold", "hold" if k else "begin", held))
        steps.append(Draws("blend", "draw", bound, targets, here, members, "load" if k else "clear"))
    return *steps, resolve


def _z_buffered(
    planner: _Planner, surface: Surface, records: tuple[tuple[str, int], ...], members: int
) -> tuple[Draws | Compute, ...]:
    """Return the passes of a band that find the nearest faces and decode what they look like.

    A lattice longer than a binding may be is bound part by part: all faces are drawn, and all pixels decoded,
    once for each part, which takes its own faces.
    """
    planner.upload("decoder", surface.decoder, "uniform")
    steps: list[Draws | Compute] = []
    for number, (name, rows) in enumerate(_parts(planner, "opacity", surface.opacity)):
        bound = (VIEW_BINDING, _BAND, Binding(2, "read", name), replace(rows, number=3))
        first = "load" if number else "clear"
        steps.append(Draws("raster", "draw", bound, ("nearest",), records, members, first, z_buffer=True))
    for name, rows in _parts(planner, "features", surface.features):
        bindings = (
            *planner.model(),
            rows,
            replace(_BAND, number=5),
            Binding(6, "numbers", "nearest"),
            Binding(7, "read", name),
            Binding(8, "uniform", "decoder"),
            replace(_PIXELS, number=9),
            Binding(10, "write", "keys"),
        )
        steps.append(Compute("decode", "decode", "surface", bindings))
    return tuple(steps)


def _parts(planner: _Planner, name: str, lattices: NDArray[Any]) -> Iterator[tuple[str, Binding]]:
    """Upload lattices of faces, as many as a binding takes; yield the buffer of each part and its rows."""
    room = planner.limits.storage // lattices[0].nbytes
    parts = _ranges(len(lattices), max(room, 1))
    for number, (first, count) in enumerate(parts):
        here = lattices[first : first + count].reshape(-1)
        padding = -here.nbytes % 4
        part = name if len(parts) == 1 else f"{name} {number}"
        planner.upload(part, np.pad(here, (0, padding)) if padding else here)
        yield part, planner.part(first, count)


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
    colors = "f_dc" in packed.arrays
    for name, array in packed.arrays.items():
        if name != "f_rest":
            planner.upload(name, array)
    colored = packed.faces if packed.soup else packed.vertices
    planner.buffer("keys", 4 * packed.faces, "storage", "copy_src")
    if colors:
        planner.buffer("colors", 12 * colored, "storage")
    if debug:
        planner.buffer("rectangles", 16 * packed.faces, "storage", "copy_src")
    dispatches: list[Compute] = []
    keys = [Binding(7, "write", "keys"), *([Binding(9, "write", "rectangles")] if debug else [])]
    room = planner.limits.binding // max(4 * packed.rest_stride, 1)
    parts = _ranges(colored if colors else 0, min(room, _GROUP * _MOST_GROUPS))
    for first, count in parts:
        name = "f_rest" if len(parts) == 1 else f"f_rest {len(dispatches)}"
        rest = packed.arrays["f_rest"]
        planner.upload(name, rest[first : first + count] if packed.rest_stride else rest)
        bindings = [
            *planner.model(),
            planner.part(first, count),
            Binding(5, "read", "f_dc"),
            Binding(6, "read", name),
            Binding(8, "write", "colors"),
            *(keys if packed.soup else []),
        ]
        module, entry = ("project", "project") if packed.soup else ("shade", "shade_vertices")
        dispatches.append(Compute("project", module, entry, tuple(bindings), -(-count // _GROUP)))
    if not packed.soup:
        for first, count in _ranges(packed.faces, _GROUP * _MOST_GROUPS):
            bindings = [*planner.model(), planner.part(first, count), *keys]
            dispatches.append(Compute("project", "project", "project", tuple(bindings), -(-count // _GROUP)))
    return dispatches


def _sorting(planner: _Planner, order: Order, chunks: int, parts: int) -> list[Compute]:
    """Return the passes of the radix sort; order "none" needs its first one alone, which drops faces."""
    faces = planner.packed.faces
    blocks = max(-(-faces // _BLOCK), 1)
    for name in ("keys a", "keys b", "faces a", "faces b"):
        planner.buffer(name, 4 * faces, "storage")
    planner.buffer("sums", 4 * (1 << _DIGIT_BITS) * blocks, "storage")
    planner.buffer("arguments", 4 * (4 + 8 * chunks * parts), "storage", "indirect", "copy_src")
    mask = 0 if order == "none" else (1 << _DIGIT_BITS) - 1
    shifts = [0] if order == "none" else list(range(0, _KEY_BITS, _DIGIT_BITS))
    steps = [(shift, mask, faces, blocks, chunks, parts, 0, 0) for shift in shifts]
    planner.upload("steps", _slots(np.array(steps, np.uint32)), "uniform")
    dispatches = []
    for k in range(len(shifts)):
        source, target = ("b", "a") if k % 2 == 0 else ("a", "b")
        step = Binding(0, "uniform", "steps", SLOT * k, 32)
        keys = Binding(1, "read", f"keys {source}" if k else "keys")
        sums, counts = Binding(5, "write", "sums"), Binding(6, "read" if k else "write", "arguments")
        moved = [Binding(3, "write", f"keys {target}"), Binding(4, "write", f"faces {target}")]
        if k:
            moved.append(Binding(2, "read", f"faces {source}"))
        module = "sort" if k else "sort first"
        size: dict[str, Any] = {"indirect": 4} if k else {"groups": blocks}
        dispatches += [
            Compute("sort", module, "count", (step, keys, sums, counts), **size),
            Compute("sort", module, "scan", (step, sums, counts), groups=1),
            Compute("sort", module, "place", (step, keys, sums, counts, *moved), **size),
        ]
    return dispatches


def _record_parts(planner: _Planner, record_bytes: int, chunks: int) -> tuple[int, int]:
    """Return how many buffers the records of a chunk take, and the records of each."""
    most = planner.limits.storage // record_bytes // _GROUP * _GROUP
    chunk = max(-(-planner.packed.faces // chunks), 1)
    parts = -(-chunk // max(min(most, _GROUP * _MOST_GROUPS), 1))
    return parts, -(-chunk // parts)


def _ranges(count: int, most: int) -> list[tuple[int, int]]:
    return [(first, min(most, count - first)) for first in range(0, count, most)]


def _slots(rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return rows of a uniform buffer, each in a slot of its own."""
    slots = np.zeros((max(len(rows), 1), SLOT // 4), np.uint32)
    if len(rows):
        slots[:, : rows.shape[1]] = rows
    return slots
