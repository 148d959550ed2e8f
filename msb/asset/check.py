"""Check a manifest first against the schema, then the relations between its keys.

This module does not read buffers. `validation.check_values` does.
"""

import math
from collections.abc import Iterator
from typing import Any

from msb.asset.manifest import ALIGNMENT, DTYPES, FORMAT, MAJOR, MINOR, TEXTURE_VERSION, VERSION
from msb.asset.schema import check_schema, describe, escape, manifest_schema
from msb.asset.texture import CHOICES, KIND, MAX_SIDE, NAME, PASS, Sampler
from msb.errors import Finding, finding, shorten
from msb.registry import METHODS

Json = dict[str, Any]

# Device names that Windows reserves, with any suffix.
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}

# Maximum SH degree of triangles. The SH degree of Gaussians can be 4.
MAX_TRIANGLE_DEGREE = 3
# The orders of the columns of f_rest. In the first order, coefficient k = 1..K of channel c = 0..2 is in
# column 3 (k - 1) + c. In the second order, coefficient k of channel c is in column c K + k - 1.
F_REST_ORDERS = ("coefficient_major", "channel_major")
# For each standard buffer: allowed dtypes, allowed lengths of the second axis, and allowed domains. If the
# length is None, the array has a single axis.
_STANDARD: dict[str, tuple[tuple[str, ...], tuple[int, ...] | None, tuple[str, ...]]] = {
    "positions": (("float32",), (3,), ("vertex",)),
    "indices": (("uint32",), (3,), ("face",)),
    "f_dc": (("float32",), (3,), ("vertex", "face", "corner")),
    "f_rest": (("float32",), (9, 24, 45, 72), ("vertex", "face", "corner")),
    "opacity": (("float32",), None, ("vertex", "face", "corner")),
    "sigma": (("float32",), None, ("vertex", "face", "corner", "global")),
    "gauss.mean": (("float32",), (3,), ("face",)),
    "gauss.scale": (("float32",), (2, 3), ("face",)),
    "gauss.rotation": (("float32",), (4,), ("face",)),
    "color": (("uint8", "float32"), (3, 4), ("vertex", "face", "corner")),
    "uv": (("float32",), (2,), ("vertex", "corner")),
    "face_texture": (("uint32",), None, ("face",)),
}


def check_manifest(data: Any) -> list[Finding]:
    """Return all findings about the parsed manifest `data`.

    If the format or the major version is wrong, the check ends, because other keys may have another meaning.
    """
    if not isinstance(data, dict):
        text = f"the manifest is {describe(data)}; it must be an object"
        return [finding("TRIASSET_MANIFEST", text, pointer="")]
    if stop := _check_version(data):
        return stop
    findings = list(check_schema(data, manifest_schema()))
    if any(f.severity == "error" for f in findings):
        return _newer_minor(data) + findings
    findings += _check_counts(data)
    findings += _check_bounds(data)
    findings += _check_primitive(data)
    findings += _check_method(data)
    findings += _check_settings(data)
    for name, spec in data["buffers"].items():
        findings += _check_buffer(name, spec, data)
    findings += _check_required_buffers(data)
    findings += _check_textures(data)
    findings += _check_layout(data["buffers"])
    return _newer_minor(data) + findings


def raise_first_error(findings: list[Finding], file: object) -> None:
    """Raise the first finding that is an error. The error names `file`, the file of the manifest."""
    for item in findings:
        if item.severity == "error":
            raise item.to_error(file)


def _check_version(data: Json) -> list[Finding]:
    schema = manifest_schema()["properties"]
    findings: list[Finding] = []
    for key in ("format", "version"):
        if key not in data:
            text = f'the manifest lacks the required key "{key}"'
            return [finding("TRIASSET_FIELD", text, pointer=f"/{key}")]
        findings += check_schema(data[key], schema[key], f"/{key}")
    if not findings and _version(data)[0] != MAJOR:
        text = f"version is {data['version']}; this release reads {FORMAT} {MAJOR}.x"
        where: dict[str, Any] = {"pointer": "/version", "value": data["version"], "limit": VERSION}
        findings.append(finding("TRIASSET_VERSION_UNSUPPORTED", text, **where))
    return findings


def _newer_minor(data: Json) -> list[Finding]:
    if _version(data)[1] <= MINOR:
        return []
    text = f"version {data['version']} is newer than {MAJOR}.{MINOR}: its additions are ignored"
    return [
        finding("TRIASSET_VERSION_NEWER", text, severity="warning", pointer="/version", value=data["version"])
    ]


def _version(data: Json) -> tuple[int, int]:
    major, minor = data["version"].split(".")
    return int(major), int(minor)


def _check_minor(data: Json, what: str, needed: str) -> Iterator[Finding]:
    """Yield a finding if the manifest uses a feature (`what`) of the version `needed`, but states an older
    version."""
    if _version(data) < _version({"version": needed}):
        text = f"version is {data['version']}; {what} need {needed}"
        yield finding("TRIASSET_FIELD", text, pointer="/version", value=data["version"], limit=needed)


def _check_primitive(data: Json) -> Iterator[Finding]:
    """Yield findings about the primitive and about its SH degree."""
    is_splat, degree = data.get("primitive") == "gaussian", data["sh_degree"]
    if is_splat:
        yield from _check_minor(data, "Gaussians", VERSION)
    elif degree > MAX_TRIANGLE_DEGREE:
        text = f"sh_degree is {degree}; for triangles it must be at most {MAX_TRIANGLE_DEGREE}"
        yield finding("TRIASSET_FIELD", text, pointer="/sh_degree", value=degree, limit=MAX_TRIANGLE_DEGREE)


def _check_counts(data: Json) -> Iterator[Finding]:
    for key in ("face_count", "vertex_count"):
        if data[key] == 0:
            text = f"{key} is 0; an asset must not be empty"
            yield finding("TRIASSET_EMPTY", text, pointer=f"/{key}", value=0)
    vertices, wanted = data["vertex_count"], 3 * data["face_count"]
    if data["topology"] == "triangle_soup" and vertices != wanted:
        text = f"vertex_count is {vertices}; a triangle soup of {data['face_count']} faces has {wanted}"
        yield finding("TRIASSET_FIELD", text, pointer="/vertex_count", value=vertices, limit=wanted)


def _check_bounds(data: Json) -> Iterator[Finding]:
    for axis, low, high in zip("xyz", data["bounds"]["min"], data["bounds"]["max"], strict=True):
        if low > high:
            text = f"bounds.min is {low} but bounds.max is {high} along {axis}"
            pointer = f"/bounds/min/{'xyz'.index(axis)}"
            yield finding("TRIASSET_FIELD", text, pointer=pointer, value=low, limit=high)


def _check_method(data: Json) -> Iterator[Finding]:
    """If the method is installed, yield findings about the method and its coverage kernel."""
    name, kernel = data["method"], data["coverage"]["kernel"]
    if name not in METHODS:
        text = f"the method {name} is not installed, so only the standard tier can draw the asset; "
        text += f"installed: {', '.join(METHODS)}"
        yield finding(
            "TRIASSET_METHOD_NOT_INSTALLED", text, severity="warning", pointer="/method", value=name
        )
        return
    kernels = dict.fromkeys(method.coverage for method in METHODS.values())
    if kernel not in kernels:
        text = f"/coverage/kernel is {describe(kernel)}; it must be one of {', '.join(kernels)}"
        yield finding("TRIASSET_FIELD", text, pointer="/coverage/kernel", value=kernel)


def _check_settings(data: Json) -> Iterator[Finding]:
    if data["method"] not in METHODS:
        return
    known = METHODS[data["method"]].settings
    for name, stored in data["settings"].items():
        pointer, value, degree = f"/settings/{escape(name)}", stored["value"], data["sh_degree"]
        if name not in known:
            text = (
                f'the setting "{shorten(name)}" is unknown; {data["method"]} has {", ".join(known) or "none"}'
            )
            yield finding("TRIASSET_FIELD", text, pointer=pointer, value=name)
            continue
        problem = known[name].problem(value)
        limit = None
        if problem is None and name == "sh_degree" and value > degree:
            problem, limit = f"must be at most {degree}, the SH degree of the asset", degree
        if problem:
            text = f"setting {name} is {describe(value)}; it {problem}"
            where: dict[str, Any] = {"pointer": f"{pointer}/value", "value": value, "limit": limit}
            yield finding("TRIASSET_FIELD", text, **where)


def _check_buffer(name: str, spec: Json, data: Json) -> Iterator[Finding]:
    pointer, file, offset, length = f"/buffers/{name}", spec["file"], spec["offset"], spec["byte_length"]
    stem = file.removeprefix("buffers/").split(".", 1)[0].casefold()
    if stem in _RESERVED or ".." in file:
        text = f'buffer {name} names the file "{file}"; use "buffers/{name}.bin"'
        yield finding("TRIASSET_PATH", text, pointer=f"{pointer}/file", value=file)
    at = f"{pointer}/offset"
    if offset % ALIGNMENT:
        text = f"buffer {name} starts at byte {offset}; it must be a multiple of {ALIGNMENT}"
        yield finding("TRIASSET_BUFFER", text, pointer=at, value=offset, limit=ALIGNMENT)
    if offset + length > 2**63 - 1:
        text = f"buffer {name} ends at byte {offset + length}, beyond any file"
        yield finding("TRIASSET_BUFFER", text, pointer=at)
    yield from _check_domain(name, spec, data)
    if name in _STANDARD:
        yield from _check_standard(name, spec)
    shape = spec["shape"]
    size = math.prod(shape) * DTYPES[spec["dtype"]].itemsize  # Python integers do not overflow.
    at = f"{pointer}/byte_length"
    if size != length:
        text = f"buffer {name} has {size} bytes (shape {shape}, {spec['dtype']}); byte_length is {length}"
        yield finding("TRIASSET_BUFFER", text, pointer=at, value=length, limit=size)
    elif size == 0:
        yield finding("TRIASSET_BUFFER", f"buffer {name} is empty", pointer=f"{pointer}/shape")


def _check_domain(name: str, spec: Json, data: Json) -> Iterator[Finding]:
    domain, rows, faces = spec["domain"], spec["shape"][0], data["face_count"]
    wanted = {"vertex": data["vertex_count"], "face": faces, "corner": 3 * faces}.get(domain, rows)
    if rows != wanted:
        text = f"buffer {name} has {rows} rows; domain {domain} has {wanted}"
        pointer = f"/buffers/{name}/shape/0"
        yield finding("TRIASSET_BUFFER", text, pointer=pointer, value=rows, limit=wanted)


def _check_standard(name: str, spec: Json) -> Iterator[Finding]:
    dtypes, widths, domains = _STANDARD[name]
    pointer, shape, dtype, domain = f"/buffers/{name}", spec["shape"], spec["dtype"], spec["domain"]
    if dtype not in dtypes:
        text = f"buffer {name} is {dtype}; it must be {' or '.join(dtypes)}"
        yield finding("TRIASSET_BUFFER", text, pointer=f"{pointer}/dtype", value=dtype)
    if domain not in domains:
        text = f"buffer {name} has domain {domain}; it must be {' or '.join(domains)}"
        yield finding("TRIASSET_BUFFER", text, pointer=f"{pointer}/domain", value=domain)
    # The width of f_rest depends on sh_degree. `_check_required_buffers` checks this width.
    fits = len(shape) == 1 if widths is None else len(shape) == 2 and shape[1] in widths
    if not fits and name != "f_rest":
        wanted = "n" if widths is None else " or ".join(f"n x {width}" for width in widths)
        text = f"buffer {name} has shape {shape}; it must be {wanted}"
        yield finding("TRIASSET_BUFFER", text, pointer=f"{pointer}/shape", value=shape)


def _check_required_buffers(data: Json) -> Iterator[Finding]:
    buffers, degree = data["buffers"], data["sh_degree"]
    required = ["positions", "indices"]
    if data.get("primitive") == "gaussian":
        required += ["gauss.mean", "gauss.scale", "gauss.rotation"]
    for name in required:
        if name not in buffers:
            text = f"the manifest does not declare the buffer {name}"
            yield finding("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}")
    width = 3 * ((degree + 1) ** 2 - 1)
    if "f_rest" not in buffers:
        if degree > 0:
            text = f"sh_degree is {degree}, but the buffer f_rest of width {width} is missing"
            yield finding("TRIASSET_FIELD", text, pointer="/buffers/f_rest", limit=width)
        return
    shape, pointer = buffers["f_rest"]["shape"], "/buffers/f_rest/shape"
    if len(shape) != 2 or shape[1] != width:
        wanted = f"n x {width}" if degree else "absent"
        text = f"buffer f_rest has shape {shape}; with sh_degree {degree} it must be {wanted}"
        yield finding("TRIASSET_FIELD", text, pointer=pointer, value=shape, limit=width)
    order = data["appearance"].get("f_rest_order")
    if order not in F_REST_ORDERS:
        text = f"appearance.f_rest_order is {describe(order)}; with a buffer f_rest it must be "
        text += " or ".join(F_REST_ORDERS)
        yield finding("TRIASSET_FIELD", text, pointer="/appearance/f_rest_order", value=order)


def _check_textures(data: Json) -> Iterator[Finding]:
    """Yield findings about textures, about their sampler, and about the buffers and passes that textures
    need."""
    appearance, buffers = data["appearance"], data["buffers"]
    names = [name for name in buffers if name.partition(".")[0] == "texture"]
    passes = data["required_passes"].get("standard", [])
    if appearance["kind"] != KIND:
        if PASS in passes:
            text = f"the pass {PASS} requires appearance.kind {KIND}"
            yield finding("TRIASSET_FIELD", text, pointer="/required_passes/standard")
        return
    yield from _check_minor(data, "textures", TEXTURE_VERSION)
    if PASS not in passes:
        text = f"/required_passes/standard is {describe(passes)}; textures need {PASS}"
        yield finding("TRIASSET_FIELD", text, pointer="/required_passes/standard")
    yield from _check_sampler(appearance)
    wanted = ["uv", *(f"texture.{number}" for number in range(max(1, len(names))))]
    for name in wanted:
        if name not in buffers:
            text = f"the manifest does not declare the buffer {name}, which textures need"
            yield finding("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}")
    for name in names:
        yield from _check_texture(name, buffers[name])
    if (len(names) > 1) != ("face_texture" in buffers):
        need = "required" if len(names) > 1 else "not allowed"
        text = f"the buffer face_texture is {need} for {len(names)} texture{'s'[: len(names) != 1]}"
        yield finding("TRIASSET_BUFFER", text, pointer="/buffers/face_texture")


def _check_sampler(appearance: Json) -> Iterator[Finding]:
    for key in Sampler.__dataclass_fields__:
        value, pointer = appearance.get(key), f"/appearance/{key}"
        if key in CHOICES:
            right, rule = value in CHOICES[key], f"one of {', '.join(CHOICES[key])}"
        elif key == "mipmaps":
            right, rule = isinstance(value, bool), "true or false"
        else:
            number = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1
            right, rule = key in appearance and (value is None or number), "null, or a number from 0 to 1"
        if not right:
            text = f"{pointer} is {describe(value) if key in appearance else 'missing'}; it must be {rule}"
            yield finding("TRIASSET_FIELD", text, pointer=pointer, value=value)


def _check_texture(name: str, spec: Json) -> Iterator[Finding]:
    shape = spec["shape"]
    right = len(shape) == 3 and shape[2] in (3, 4) and max(shape[:2]) <= MAX_SIDE
    if not (NAME.fullmatch(name) and right and (spec["dtype"], spec["domain"]) == ("uint8", "global")):
        text = (
            f"buffer {name} is {spec['dtype']} {shape} of domain {spec['domain']}; a texture must be uint8, "
        )
        text += f"H x W x 3 or 4, at most {MAX_SIDE} per side, of domain global"
        yield finding("TRIASSET_BUFFER", text, pointer=f"/buffers/{name}/shape", value=shape, limit=MAX_SIDE)


def _check_layout(buffers: dict[str, Json]) -> Iterator[Finding]:
    """Yield findings about the positions of the buffers in their files.

    The buffers in a file must fill the file from byte 0, aligned and without gaps.
    """
    # Collect (offset, length, name) of the buffers of each file.
    files: dict[str, list[tuple[int, int, str]]] = {}
    for name, spec in buffers.items():
        files.setdefault(spec["file"], []).append((spec["offset"], spec["byte_length"], name))
    folded: dict[str, str] = {}
    for file, parts in files.items():
        twin = folded.setdefault(file.casefold(), file)
        if twin != file:
            text = f'"{file}" and "{twin}" are the same file on systems that ignore upper and lower case'
            pointer = f"/buffers/{parts[0][2]}/file"
            yield finding("TRIASSET_PATH", text, pointer=pointer, value=file)
        end, before = 0, ""
        for offset, length, name in sorted(parts):
            where: dict[str, Any] = {"pointer": f"/buffers/{name}/offset", "value": offset}
            start = -(-end // ALIGNMENT) * ALIGNMENT
            if offset < end:
                text = f"buffers {before} and {name} overlap in {file}: {name} starts at byte {offset}, "
                text += f"{before} ends at {end}"
                yield finding("TRIASSET_BUFFER", text, **where, limit=end)
            elif offset > start:
                text = f"bytes {end} to {offset} of {file} are unused; {name} must start at byte {start}"
                yield finding("TRIASSET_DAMAGED", text, **where, limit=start)
            end, before = max(end, offset + length), name
