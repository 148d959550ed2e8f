"""Creates the plan for an asset's frames: WGSL modules, buffers, and passes.

A frame of a blended method has these stages:

1. project: compute the depth key of every face, and the colours of faces or vertices.

2. sort: a radix sort of the visible faces by key, front to back.

3. records: write the data of each face for the fragment shader (its "record"), in sorted order.

4. blend: draw a quad for each record into the targets, in chunks of faces.

5. resolve: average samples to pixels and add the background.

A method with an opaque surface does not need a sorted order. A z-buffer frame has the stages "raster" and
"decode" instead of "blend". The stage "raster" finds the nearest face of each pixel with a z-buffer, and
"decode" computes the appearance of this face.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.engines.hardware.packing import VIEW, Packed
from msb.engines.hardware.plan import SLOT, Binding, ComputePass, DrawPass, Limits, Plan
from msb.engines.hardware.wgsl import add_attribute_locations, assemble, find_face_members
from msb.errors import DeviceError
from msb.registry import Order, Sampling
from msb.render.surface import Surface

# Invocations per workgroup of the stages that process faces. @workgroup_size in project.wgsl is equal.
_GROUP = 64
# Largest number of workgroups along an axis that WebGPU guarantees.
_MAX_GROUPS = 65535
# Items per workgroup of the radix sort, bits per digit, and bits per key; sort.wgsl has arrays of these
# sizes.
_BLOCK = 2048
_DIGIT_BITS = 4
_KEY_BITS = 32
# In some methods, a sample is complete once its transmittance falls below a threshold. A complete sample
# ignores the remaining faces. If a method stops samples, its faces are drawn in this number of chunks.
# Hardware blending reveals the transmittance only between chunks. Blending in more chunks is more accurate,
# but slower. With 32 chunks all golden views have at least 70 dB; docs/dedicated.md has measurements.
STOPS = 32
_STOPS_EARLY = re.compile(r"^const STOP = ", re.MULTILINE)
_TYPES = {"float32": "f32", "int32": "i32", "uint32": "u32"}


class _Planner:
    """Collects the buffers of a plan, and checks the limits of the device `name`."""

    def __init__(self, packed: Packed, limits: Limits, name: str) -> None:
        self.packed, self.limits, self.name = packed, limits, name
        self.buffers: dict[str, tuple[int, tuple[str, ...]]] = {}
        self.data: dict[str, NDArray[Any]] = {}
        # Content of the uniform buffer `parts`: the first row and the number of rows of each part.
        self.parts: list[tuple[int, int]] = []

    def buffer(self, name: str, size: int, *usages: str) -> None:
        """Add a buffer of `size` bytes, rounded up to a multiple of 16."""
        size = max(-(-size // 16) * 16, 16)
        limit = self.limits.storage if "storage" in usages else self.limits.buffer
        if size > limit:
            text = (
                f"this asset needs a buffer of {size:,} bytes for {name}, but {self.name} allows only "
                f"{limit:,}"
            )
            raise DeviceError("DEVICE_MEMORY", text)
        self.buffers[name] = size, usages

    def upload(self, name: str, array: NDArray[Any], usage: str = "storage") -> None:
        """Add a buffer with the content `array`."""
        self.buffer(name, array.nbytes, usage, "copy_dst")
        self.data[name] = array

    def part(self, first: int, count: int) -> Binding:
        """Return a uniform binding with the first row and the number of rows of a dispatch."""
        self.parts.append((first, count))
        return Binding(1, "uniform", "parts", SLOT * (len(self.parts) - 1), 16)

    def model(self) -> list[Binding]:
        """Return the bindings of the camera and the geometry, which all stages that process faces read."""
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
    """Return the plan for frames of an asset.

    Parameters
    ----------
    packed : Packed
        The asset.
    limits, name : Limits, str
        The limits of the device, and its name for error messages.
    order, sampling : str
        The same options as in the OpenCL renderer.
    form : str
        Texture format of the blended targets.
    stops : int
        Number of chunks of faces, for methods that stop samples (see `STOPS`); with 1 chunk no sample stops.
    depth : bool
        Whether to compute a depth image.
    debug : bool
        Whether to keep the tile rectangles of faces, in the buffer `rectangles`.

    Raises
    ------
    DeviceError
        DEVICE_MEMORY: a buffer exceeds the limits.
    """
    model, planner = packed.model, _Planner(packed, limits, name)
    surface = packed.surface
    lattices: dict[str, bool | int | str] = {}
    if surface is not None:
        # the z-buffer finds the nearest face in any order; the target holds face numbers
        order, form = "none", "r32uint"
        as_bytes = surface.features.dtype == np.uint8
        lattices = {"SIDE": 1 << surface.level, "BYTES": as_bytes, "TEXEL": "u32" if as_bytes else "f32"}
    defines: dict[str, bool | int | str] = {
        **{key: bool(value) for key, value in packed.defines.items()},
        "OWN_MEMBERS": "\n".join(f"    {k}: {_TYPES[v.dtype.name]}," for k, v in model.method_values.items()),
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
    method_file = f"{model.program}.wgsl"
    chunks = stops if _STOPS_EARLY.search(assemble([method_file], model.package, defines)) else 1
    defines["STOPS"] = chunks > 1

    def text(*files: str, **more: bool | int | str) -> str:
        return assemble(files, model.package, {**defines, **more})

    # Names of the vec4 members in the method's per-face data ("record").
    members = find_face_members(text(method_file))
    record_bytes = 16 * len(members)
    modules = {
        "project": text(method_file, "project.wgsl", COMPUTE=True, KEYING=True, COLORING=packed.soup),
        "record": text(method_file, "project.wgsl", COMPUTE=True, RECORDING=True),
        "sort first": text("sort.wgsl", FIRST=True, BLOCK=_BLOCK),
        "sort": text("sort.wgsl", BLOCK=_BLOCK),
        "draw": add_attribute_locations(text(method_file, "draw.wgsl", **_define_between(members)), members),
        "resolve": text("resolve.wgsl"),
    }
    if chunks > 1:
        modules["hold"] = text("hold.wgsl")
    if surface is not None:
        modules["decode"] = text(method_file, "surface.wgsl", COMPUTE=True, DECODING=True)
        del modules["resolve"]
    elif not packed.soup:
        modules["shade"] = text(method_file, "project.wgsl", COMPUTE=True, COLORING=True, SHADING=True)
    # Records are divided into chunks, between which samples can stop. A chunk is divided into parts, which
    # fit into one buffer each. Each part of each chunk has its own buffer.
    parts, room = _split_records(planner, record_bytes, chunks)
    passes = [*_plan_projection(planner, debug), *_plan_sorting(planner, order, chunks, parts)]
    last = "faces a" if order == "none" else "faces b"
    records = []
    for k in range(chunks * parts):
        planner.buffer(f"records {k}", room * record_bytes, "storage", "vertex")
        start = 4 + 8 * k  # entry of this buffer in `arguments`, see `write_arguments` in sort.wgsl
        bindings = [
            *planner.model(),
            planner.part(start, room),
            Binding(8, "read", "colors") if surface is None else Binding(7, "write", "keys"),
            Binding(10, "read", last),
            Binding(11, "read", "arguments"),
            Binding(12, "write", f"records {k}"),
        ]
        passes.append(ComputePass("records", "record", "record", tuple(bindings), indirect=4 * start))
        records.append((f"records {k}", 4 * (start + 4)))
    planner.buffer("view", VIEW.itemsize + 4 * len(model.method_values), "uniform", "copy_dst")
    if surface is not None:
        band_passes = _plan_z_buffer(planner, surface, tuple(records), len(members))
    else:
        targets = ("image", "depth") if depth else ("image",)
        band_passes = _plan_blending(targets, tuple(records), len(members), chunks)
    planner.upload("parts", _pad_to_slots(np.array(planner.parts, np.uint32)), "uniform")
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


def _plan_blending(
    targets: tuple[str, ...], records: tuple[tuple[str, int], ...], members: int, chunks: int
) -> tuple[DrawPass | ComputePass, ...]:
    """Return the passes of a band that blend faces and average samples to pixels.

    With several chunks, the pass "hold" runs before each chunk and copies the alpha of the samples to the
    texture `covered`. The draw pass of the chunk reads `covered` and skips opaque samples.
    """
    textures = tuple(Binding(2 + k, "texture", target) for k, target in enumerate(targets))
    resolve = ComputePass("resolve", "resolve", "resolve", (VIEW_BINDING, _BAND, *textures, _PIXELS))
    if chunks == 1:
        return DrawPass("blend", "draw", (VIEW_BINDING, _BAND), targets, records, members), resolve
    hold_bindings = (_BAND, Binding(2, "texture", "image"), Binding(3, "store", "covered"))
    bound = (VIEW_BINDING, _BAND, Binding(2, "texture", "covered"))
    parts = len(records) // chunks
    steps: list[DrawPass | ComputePass] = []
    for k in range(chunks):
        chunk = records[k * parts : (k + 1) * parts]
        steps.append(ComputePass("blend", "hold", "hold" if k else "begin", hold_bindings))
        steps.append(DrawPass("blend", "draw", bound, targets, chunk, members, "load" if k else "clear"))
    return *steps, resolve


def _plan_z_buffer(
    planner: _Planner, surface: Surface, records: tuple[tuple[str, int], ...], members: int
) -> tuple[DrawPass | ComputePass, ...]:
    """Return the passes of a band that find the nearest face of each pixel and compute its appearance.

    Feature lattices that exceed the limit of a binding are split into parts. Each part draws all faces and
    decodes all pixels, but changes only pixels that show its own faces.
    """
    planner.upload("decoder", surface.decoder, "uniform")
    steps: list[DrawPass | ComputePass] = []
    for number, (name, rows) in enumerate(_upload_parts(planner, "opacity", surface.opacity)):
        bound = (VIEW_BINDING, _BAND, Binding(2, "read", name), replace(rows, number=3))
        first = "load" if number else "clear"
        steps.append(DrawPass("raster", "draw", bound, ("nearest",), records, members, first, z_buffer=True))
    for name, rows in _upload_parts(planner, "features", surface.features):
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
        steps.append(ComputePass("decode", "decode", "surface", bindings))
    return tuple(steps)


def _upload_parts(planner: _Planner, name: str, lattices: NDArray[Any]) -> Iterator[tuple[str, Binding]]:
    """Upload the feature lattices (F, ...) in parts that fit a binding; yield name and rows of each part."""
    room = planner.limits.storage // lattices[0].nbytes
    parts = _split_range(len(lattices), max(room, 1))
    for number, (first, count) in enumerate(parts):
        rows_of_part = lattices[first : first + count].reshape(-1)
        padding = -rows_of_part.nbytes % 4
        part = name if len(parts) == 1 else f"{name} {number}"
        planner.upload(part, np.pad(rows_of_part, (0, padding)) if padding else rows_of_part)
        yield part, planner.part(first, count)


def _define_between(members: list[str]) -> dict[str, str]:
    """Return the definitions of draw.wgsl that pass a record from the vertex to the fragment shader."""
    return {
        "BETWEEN_MEMBERS": "\n".join(
            f"    @location({k}) @interpolate(flat) {name}: vec4<f32>," for k, name in enumerate(members)
        ),
        "BETWEEN_COPIES": "\n".join(f"    between.{name} = face.{name};" for name in members),
        "FACE_VALUES": ", ".join(f"between.{name}" for name in members),
    }


def _plan_projection(planner: _Planner, debug: bool) -> list[ComputePass]:
    """Return the passes that compute the key of every face, and the colours of faces or vertices.

    The spherical harmonics `f_rest` may be split into parts that fit a binding. Each part of the spherical
    harmonics has a separate dispatch.
    """
    packed = planner.packed
    colors = "f_dc" in packed.arrays
    for name, array in packed.arrays.items():
        if name != "f_rest":
            planner.upload(name, array)
    colored = packed.faces if packed.soup else packed.vertices  # number of rows with a colour
    planner.buffer("keys", 4 * packed.faces, "storage", "copy_src")
    if colors:
        planner.buffer("colors", 12 * colored, "storage")
    if debug:
        planner.buffer("rectangles", 16 * packed.faces, "storage", "copy_src")
    dispatches: list[ComputePass] = []
    keys = [Binding(7, "write", "keys"), *([Binding(9, "write", "rectangles")] if debug else [])]
    room = planner.limits.binding // max(4 * packed.rest_stride, 1)
    parts = _split_range(colored if colors else 0, min(room, _GROUP * _MAX_GROUPS))
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
        dispatches.append(ComputePass("project", module, entry, tuple(bindings), -(-count // _GROUP)))
    if not packed.soup:
        for first, count in _split_range(packed.faces, _GROUP * _MAX_GROUPS):
            bindings = [*planner.model(), planner.part(first, count), *keys]
            dispatches.append(
                ComputePass("project", "project", "project", tuple(bindings), -(-count // _GROUP))
            )
    return dispatches


def _plan_sorting(planner: _Planner, order: Order, chunks: int, parts: int) -> list[ComputePass]:
    """Return the passes of the radix sort by depth key.

    Each digit needs three passes: count the digits of each block, scan the counts, and move keys and face
    numbers. With order "none" there is a single step without digits, which removes the culled faces.
    """
    faces = planner.packed.faces
    blocks = max(-(-faces // _BLOCK), 1)
    for name in ("keys a", "keys b", "faces a", "faces b"):
        planner.buffer(name, 4 * faces, "storage")
    planner.buffer("sums", 4 * (1 << _DIGIT_BITS) * blocks, "storage")
    planner.buffer("arguments", 4 * (4 + 8 * chunks * parts), "storage", "indirect", "copy_src")
    mask = 0 if order == "none" else (1 << _DIGIT_BITS) - 1
    shifts = [0] if order == "none" else list(range(0, _KEY_BITS, _DIGIT_BITS))
    steps = [(shift, mask, faces, blocks, chunks, parts, 0, 0) for shift in shifts]
    planner.upload("steps", _pad_to_slots(np.array(steps, np.uint32)), "uniform")
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
            ComputePass("sort", module, "count", (step, keys, sums, counts), **size),
            ComputePass("sort", module, "scan", (step, sums, counts), groups=1),
            ComputePass("sort", module, "place", (step, keys, sums, counts, *moved), **size),
        ]
    return dispatches


def _split_records(planner: _Planner, record_bytes: int, chunks: int) -> tuple[int, int]:
    """Return the number of record buffers of a chunk, and the maximum number of records per buffer."""
    most = planner.limits.storage // record_bytes // _GROUP * _GROUP
    chunk = max(-(-planner.packed.faces // chunks), 1)
    parts = -(-chunk // max(min(most, _GROUP * _MAX_GROUPS), 1))
    return parts, -(-chunk // parts)


def _split_range(count: int, most: int) -> list[tuple[int, int]]:
    """Split `count` rows into parts of at most `most` rows; return (first, length) of each part."""
    return [(first, min(most, count - first)) for first in range(0, count, most)]


def _pad_to_slots(rows: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the content of a uniform buffer with a separate slot for each row of at most 64 values."""
    slots = np.zeros((max(len(rows), 1), SLOT // 4), np.uint32)
    if len(rows):
        slots[:, : rows.shape[1]] = rows
    return slots
