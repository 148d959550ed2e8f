"""Check a manifest as a whole: the schema first, then what one key says about another.

Nothing here reads a buffer. `check_values` in `validation.py` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from msb.asset.manifest import ALIGNMENT, DTYPES, FORMAT, MAJOR, MINOR, VERSION
from msb.asset.schema import check_schema, describe, escape, manifest_schema
from msb.errors import Finding, finding, shorten
from msb.registry import METHODS

Json = dict[str, Any]

# Windows opens a device when asked for one of these, whatever the extension.
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}

F_REST_ORDERS = ("coefficient_major", "channel_major")
"""Coefficient k = 1..K of channel c = 0..2 is in column 3 (k - 1) + c, or in column c K + k - 1."""
# name -> (dtypes, width of the second axis or None for a flat buffer, domains)
_STANDARD: dict[str, tuple[tuple[str, ...], tuple[int, ...] | None, tuple[str, ...]]] = {
    "positions": (("float32",), (3,), ("vertex",)),
    "indices": (("uint32",), (3,), ("face",)),
    "f_dc": (("float32",), (3,), ("vertex", "face", "corner")),
    "f_rest": (("float32",), (9, 24, 45), ("vertex", "face", "corner")),
    "opacity": (("float32",), None, ("vertex", "face", "corner")),
    "sigma": (("float32",), None, ("vertex", "face", "corner", "global")),
    "color": (("uint8", "float32"), (3, 4), ("vertex", "face", "corner")),
}


def check_manifest(data: Any) -> list[Finding]:
    """Return every finding about the parsed manifest `data`.

    A wrong format or major version ends the check, because the other keys then mean something else.
    """
    if not isinstance(data, dict):
        text = f"the manifest is {describe(data)}; it must be an object"
        return [finding("TRIASSET_MANIFEST", text, pointer="")]
    if stop := _check_version(data):
        return stop
    found = list(check_schema(data, manifest_schema()))
    if any(f.severity == "error" for f in found):
        return _newer_minor(data) + found
    found += _check_counts(data)
    found += _check_bounds(data)
    found += _check_method(data)
    found += _check_settings(data)
    for name, spec in data["buffers"].items():
        found += _check_buffer(name, spec, data)
    found += _check_required_buffers(data)
    found += _check_layout(data["buffers"])
    return _newer_minor(data) + found


def _check_version(data: Json) -> list[Finding]:
    schema = manifest_schema()["properties"]
    found: list[Finding] = []
    for key in ("format", "version"):
        if key not in data:
            text = f'the manifest lacks the required key "{key}"'
            return [finding("TRIASSET_FIELD", text, pointer=f"/{key}")]
        found += check_schema(data[key], schema[key], f"/{key}")
    if not found and _version(data)[0] != MAJOR:
        found.append(
            finding(
                "TRIASSET_VERSION_UNSUPPORTED",
                f"version is {data['version']}; this release reads {FORMAT} {MAJOR}.x",
                pointer="/version",
                value=data["version"],
                limit=VERSION,
            )
        )
    return found


def _newer_minor(data: Json) -> list[Finding]:
    if _version(data)[1] <= MINOR:
        return []
    text = f"version {data['version']} is newer than {VERSION}: what it added is ignored"
    return [
        finding("TRIASSET_VERSION_NEWER", text, severity="warning", pointer="/version", value=data["version"])
    ]


def _version(data: Json) -> tuple[int, int]:
    major, minor = data["version"].split(".")
    return int(major), int(minor)


def _check_counts(data: Json) -> Iterator[Finding]:
    faces, vertices = data["face_count"], data["vertex_count"]
    for key, count in (("face_count", faces), ("vertex_count", vertices)):
        if count == 0:
            yield finding(
                "TRIASSET_EMPTY", f"{key} is 0; an asset draws something", pointer=f"/{key}", value=0
            )
    if data["topology"] == "triangle_soup" and vertices != 3 * faces:
        yield finding(
            "TRIASSET_FIELD",
            f"vertex_count is {vertices}; a soup of {faces} faces has {3 * faces}",
            pointer="/vertex_count",
            value=vertices,
            limit=3 * faces,
        )


def _check_bounds(data: Json) -> Iterator[Finding]:
    low, high = data["bounds"]["min"], data["bounds"]["max"]
    for axis, (a, b) in enumerate(zip(low, high, strict=True)):
        if a > b:
            yield finding(
                "TRIASSET_FIELD",
                f"bounds.min is {a} but bounds.max is {b} along {'xyz'[axis]}",
                pointer=f"/bounds/min/{axis}",
                value=a,
                limit=b,
            )


def _check_method(data: Json) -> Iterator[Finding]:
    """Yield what is wrong with the method's name and its kernel, as far as the method is known here."""
    name, kernel = data["method"], data["coverage"]["kernel"]
    if name not in METHODS:
        yield finding(
            "TRIASSET_METHOD_NOT_INSTALLED",
            f"the method {name} is not installed: only the standard tier can show the asset; "
            f"there are {', '.join(METHODS)}",
            severity="warning",
            pointer="/method",
            value=name,
        )
        return
    kernels = dict.fromkeys(method.coverage for method in METHODS.values())
    if kernel not in kernels:
        yield finding(
            "TRIASSET_FIELD",
            f"/coverage/kernel is {describe(kernel)}; it must be one of {', '.join(kernels)}",
            pointer="/coverage/kernel",
            value=kernel,
        )


def _check_settings(data: Json) -> Iterator[Finding]:
    if data["method"] not in METHODS:
        return
    known = METHODS[data["method"]].settings
    for name, stored in data["settings"].items():
        pointer = f"/settings/{escape(name)}"
        if name not in known:
            valid = ", ".join(known) or "none"
            yield finding(
                "TRIASSET_FIELD",
                f'{data["method"]} has no setting "{shorten(name)}"; it has {valid}',
                pointer=pointer,
                value=name,
            )
        elif problem := known[name].problem(stored["value"]):
            yield finding(
                "TRIASSET_FIELD",
                f"setting {name} is {describe(stored['value'])}; it {problem}",
                pointer=f"{pointer}/value",
                value=stored["value"],
            )
        elif name == "sh_degree" and stored["value"] > data["sh_degree"]:
            yield finding(
                "TRIASSET_FIELD",
                f"setting sh_degree is {stored['value']}; the asset stores degree {data['sh_degree']} only",
                pointer=f"{pointer}/value",
                value=stored["value"],
                limit=data["sh_degree"],
            )


def _check_buffer(name: str, spec: Json, data: Json) -> Iterator[Finding]:
    pointer = f"/buffers/{name}"
    shape, size = spec["shape"], DTYPES[spec["dtype"]].itemsize
    count = math.prod(shape)  # Python integers: no product overflows
    if _stem(spec["file"]) in _RESERVED or ".." in spec["file"]:
        yield finding(
            "TRIASSET_PATH",
            f'buffer {name} names the file "{spec["file"]}"; use "buffers/{name}.bin"',
            pointer=f"{pointer}/file",
            value=spec["file"],
        )
    if spec["offset"] % ALIGNMENT:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} starts at byte {spec['offset']}; it must be a multiple of {ALIGNMENT}",
            pointer=f"{pointer}/offset",
            value=spec["offset"],
            limit=ALIGNMENT,
        )
    if spec["offset"] + spec["byte_length"] > 2**63 - 1:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} ends at byte {spec['offset'] + spec['byte_length']}, past any file",
            pointer=f"{pointer}/offset",
        )
    yield from _check_domain(name, spec, data)
    yield from _check_standard(name, spec)
    if count * size != spec["byte_length"]:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} has shape {shape} of {spec['dtype']}, {count * size} bytes, "
            f"but byte_length is {spec['byte_length']}",
            pointer=f"{pointer}/byte_length",
            value=spec["byte_length"],
            limit=count * size,
        )
    elif count == 0:
        yield finding("TRIASSET_BUFFER", f"buffer {name} holds no values", pointer=f"{pointer}/shape")


def _check_domain(name: str, spec: Json, data: Json) -> Iterator[Finding]:
    vertices, faces = data["vertex_count"], data["face_count"]
    wanted = {"vertex": vertices, "face": faces, "corner": 3 * faces}.get(spec["domain"])
    if wanted is not None and spec["shape"][0] != wanted:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} has {spec['shape'][0]} rows; domain {spec['domain']} has {wanted}",
            pointer=f"/buffers/{name}/shape/0",
            value=spec["shape"][0],
            limit=wanted,
        )


def _check_standard(name: str, spec: Json) -> Iterator[Finding]:
    if name not in _STANDARD:
        return
    dtypes, widths, domains = _STANDARD[name]
    pointer, shape = f"/buffers/{name}", spec["shape"]
    if spec["dtype"] not in dtypes:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} is {spec['dtype']}; it must be {' or '.join(dtypes)}",
            pointer=f"{pointer}/dtype",
            value=spec["dtype"],
        )
    if spec["domain"] not in domains:
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} has domain {spec['domain']}; it must be {' or '.join(domains)}",
            pointer=f"{pointer}/domain",
            value=spec["domain"],
        )
    if name == "f_rest":
        return  # its width is a matter of sh_degree, checked with it
    flat = widths is None and len(shape) == 1
    if not flat and not (widths is not None and len(shape) == 2 and shape[1] in widths):
        wanted = "n" if widths is None else " or ".join(f"n x {w}" for w in widths)
        yield finding(
            "TRIASSET_BUFFER",
            f"buffer {name} has shape {shape}; it must be {wanted}",
            pointer=f"{pointer}/shape",
            value=shape,
        )


def _check_required_buffers(data: Json) -> Iterator[Finding]:
    buffers, degree = data["buffers"], data["sh_degree"]
    for name in ("positions", "indices"):
        if name not in buffers:
            text = f"the manifest declares no buffer {name}"
            yield finding("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}")
    width = 3 * ((degree + 1) ** 2 - 1)
    if "f_rest" in buffers:
        shape = buffers["f_rest"]["shape"]
        if len(shape) != 2 or shape[1] != width:
            wanted = f"n x {width}" if degree else "absent"
            yield finding(
                "TRIASSET_FIELD",
                f"buffer f_rest has shape {shape}; with sh_degree {degree} it must be {wanted}",
                pointer="/buffers/f_rest/shape",
                value=shape,
                limit=width,
            )
        order = data["appearance"].get("f_rest_order")
        if order not in F_REST_ORDERS:
            yield finding(
                "TRIASSET_FIELD",
                f"appearance.f_rest_order is {describe(order)}; with a buffer f_rest it must be "
                + " or ".join(F_REST_ORDERS),
                pointer="/appearance/f_rest_order",
                value=order,
            )
    elif degree > 0:
        yield finding(
            "TRIASSET_FIELD",
            f"sh_degree is {degree} but there is no buffer f_rest of width {width}",
            pointer="/buffers/f_rest",
            limit=width,
        )


def _check_layout(buffers: dict[str, Json]) -> Iterator[Finding]:
    """Yield what is wrong with how buffers share files: they must tile each file from byte 0, aligned."""
    files: dict[str, list[tuple[int, int, str]]] = {}
    for name, spec in buffers.items():
        files.setdefault(spec["file"], []).append((spec["offset"], spec["byte_length"], name))
    folded: dict[str, str] = {}
    for file, parts in files.items():
        twin = folded.setdefault(file.casefold(), file)
        if twin != file:
            yield finding(
                "TRIASSET_PATH",
                f'"{file}" and "{twin}" are one file where upper and lower case are not told apart',
                pointer=f"/buffers/{parts[0][2]}/file",
                value=file,
            )
        end, before = 0, ""
        for offset, length, name in sorted(parts):
            pointer = f"/buffers/{name}/offset"
            start = -(-end // ALIGNMENT) * ALIGNMENT
            if offset < end:
                yield finding(
                    "TRIASSET_BUFFER",
                    f"buffers {before} and {name} share bytes of {file}: {name} starts at byte {offset}, "
                    f"{before} ends at {end}",
                    pointer=pointer,
                    value=offset,
                    limit=end,
                )
            elif offset > start:
                yield finding(
                    "TRIASSET_DAMAGED",
                    f"bytes {end} to {offset} of {file} belong to no buffer; {name} must start at {start}",
                    pointer=pointer,
                    value=offset,
                    limit=start,
                )
            end, before = max(end, offset + length), name


def _stem(file: str) -> str:
    return file.removeprefix("buffers/").split(".", 1)[0].casefold()
