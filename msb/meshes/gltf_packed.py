"""Decompresses the arrays of glTF files. meshopt compresses buffer views, and Draco compresses primitives.

The decoders are C++ code of other projects. The decoders run in a child process, so that a crash becomes an
error message. The memory limit of the child process is proportional to the declared sizes of the arrays.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays, run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import MeshFileError, shorten
from msb.meshes.gltf import Document

MESHOPT = ("KHR_meshopt_compression", "EXT_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
# `_READ` has prefixes of attributes that are read. `_EXPLAINING` has attributes that only explain duplicated
# vertices. The attributes in `_EXPLAINING` are optional. If their decoding fails, the mesh is read without
# these attributes.
_READ = ("POSITION", "COLOR_0", "TEXCOORD_", "JOINTS_", "WEIGHTS_")
_EXPLAINING = ("NORMAL", "TANGENT")
# Time limit of the child process, in seconds.
_SECONDS = 300
# Memory limit of the child process: 1 GiB, plus 16 times the size of the decoded arrays.
_BASE_GIB, _GIB_PER_GIB = 1.0, 16.0
# The JSON description of a buffer view or Draco primitive to decode.
Job = dict[str, Any]


def unpack(document: Document, meshes: list[int], *, every_view: bool = False) -> None:
    """Decode the compressed arrays of `meshes`, unless the file also contains the uncompressed array.

    With `every_view`, all other compressed buffer views are decoded, too, for example those of animations.

    Decoded buffer views are stored in `document.views`. Attributes and indices of Draco primitives are stored
    in `document.packed`. The total size of the decoded arrays is limited to `document.limit`.
    """
    jobs = list(_list_jobs(document, meshes))
    if every_view:
        known = {job["view"] for job in jobs if "view" in job}
        views = range(len(document.array(document.root, "bufferViews", "")))
        jobs += [job for view in views if view not in known for job in _list_meshopt_jobs(document, view)]
    if all(job.get("optional") for job in jobs):
        return
    # Check the declared sizes of the arrays. Read all buffers before computing the limit, so that the limit
    # includes linked files.
    total = sum(job["bytes"] for job in jobs)
    document.check_total("the compressed arrays", total)
    modules = sorted({"DracoPy" if job["mode"] == "DRACO" else "meshopt" for job in jobs})
    need_extra("compressed", *modules, what=f"the compressed mesh in {shorten(document.source.path, 200)}")
    # Concatenate the compressed data of all jobs, and send the data and the descriptions to the child
    # process.
    data = [job.pop("data") for job in jobs]
    ends = np.cumsum([len(content) for content in data]).tolist()
    for job, end, content in zip(jobs, ends, data, strict=True):
        job["place"] = [end - len(content), end]
    joined = np.frombuffer(b"".join(data) + b"\0", np.uint8)
    plan = np.frombuffer(json.dumps(jobs).encode(), np.uint8)
    limits = Limits(_SECONDS, _BASE_GIB + _GIB_PER_GIB * total / 2**30)
    reply = run_in_child(unpack_here, "", {"plan": plan, "data": joined}, limits)
    if reply.why:
        raise document.source.error(
            "MESH_FILE_INVALID", f"the compressed arrays cannot be decoded: {reply.why}"
        )
    for number, job in enumerate(jobs):
        if job["mode"] == "DRACO":
            _store_primitive(document, job, number, reply.arrays)
        elif f"{number}" in reply.arrays:
            document.views[job["view"]] = memoryview(reply.arrays[f"{number}"].tobytes())


def unpack_here(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Decode all jobs in `arrays`.

    This function runs in the child process. The function is a `Work` of `msb.base.children`.
    """
    decoded: dict[str, NDArray[Any]] = {}
    for number, job in enumerate(json.loads(arrays["plan"].tobytes())):
        data = arrays["data"][slice(*job["place"])].tobytes()
        try:
            if job["mode"] == "DRACO":
                decoded |= {f"{number}.{name}": array for name, array in _decode_draco(job, data)}
            else:
                import meshopt

                shape = job["count"], job["stride"]
                rows = meshopt.decode_gltf_buffer(data, *shape, job["mode"], job["filter"])
                decoded[f"{number}"] = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
        except MemoryError:
            raise
        except Exception as error:
            if job.get("optional"):
                continue
            text = f"{job['pointer']}: {error or type(error).__name__}"
            raise ValueError(text) from error
    return None, decoded


def _decode_draco(job: Job, data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the names and values of the decoded indices and attributes of a primitive."""
    import DracoPy

    mesh = DracoPy.decode(data)
    yield "indices", np.ascontiguousarray(mesh.faces)
    for name, number in job["attributes"].items():
        attribute = mesh.get_attribute_by_unique_id(number)
        if attribute is None and name in _EXPLAINING:
            continue
        if attribute is None:
            message = f"attribute {number} ({name}) does not exist in the compressed data"
            raise ValueError(message)
        yield name, np.ascontiguousarray(attribute["data"])


def _list_jobs(document: Document, meshes: list[int]) -> Iterator[Job]:
    """Yield a job for each compressed primitive, and for each compressed buffer view of other primitives."""
    views: set[int] = set()
    explaining: set[int] = set()
    for mesh in meshes:
        owner, where = document.entry("meshes", mesh)
        for number, primitive in enumerate(document.array(owner, "primitives", where)):
            pointer = f"{where}/primitives/{number}"
            if not isinstance(primitive, dict):
                continue  # `parse_primitives` reports it
            attributes = document.object(primitive, "attributes", pointer)
            used = {name: index for name, index in attributes.items() if name.startswith(_READ)}
            for name in _EXPLAINING:
                explaining |= _list_views(document, attributes.get(name))
            packed = document.object(document.object(primitive, "extensions", pointer), DRACO, pointer)
            if packed and "bufferView" not in _find_accessor(document, used.get("POSITION")):
                yield _make_draco_job(document, primitive, packed, pointer)
                continue
            targets = document.array(primitive, "targets", pointer)
            moved = [target.get("POSITION") for target in targets if isinstance(target, dict)]
            for index in (*used.values(), primitive.get("indices"), *moved):
                views |= _list_views(document, index)
    skins = document.root.get("skins")
    for skin in skins if isinstance(skins, list) else []:
        if isinstance(skin, dict):
            views |= _list_views(document, skin.get("inverseBindMatrices"))
    for view in sorted(views):
        yield from _list_meshopt_jobs(document, view)
    for view in sorted(explaining - views):
        with suppress(MeshFileError):
            yield from [job | {"optional": True} for job in _list_meshopt_jobs(document, view)]


def _find_accessor(document: Document, number: Any) -> dict[str, Any]:
    """Return the JSON of accessor `number`.

    The JSON is empty if the accessor does not exist. A later check reports a missing accessor.
    """
    entries = document.array(document.root, "accessors", "")
    exists = type(number) is int and 0 <= number < len(entries) and isinstance(entries[number], dict)
    return entries[number] if exists else {}


def _list_views(document: Document, number: Any) -> set[int]:
    """Return the indices of the buffer views that accessor `number` uses."""
    entry = _find_accessor(document, number)
    sparse = entry.get("sparse")
    parts = [sparse.get("indices"), sparse.get("values")] if isinstance(sparse, dict) else []
    views = [part.get("bufferView") for part in (entry, *parts) if isinstance(part, dict)]
    count = len(document.array(document.root, "bufferViews", ""))
    return {view for view in views if type(view) is int and 0 <= view < count}


def _list_meshopt_jobs(document: Document, index: int) -> Iterator[Job]:
    """Yield the job for view `index` if the view is compressed and has no uncompressed copy."""
    view, pointer = document.entry("bufferViews", index)
    extensions = document.object(view, "extensions", pointer)
    name = next((extension for extension in MESHOPT if extension in extensions), None)
    if name is None:
        return
    # A view has an uncompressed copy if its buffer exists and is not marked as a fallback.
    number = document.integer(view, "buffer", pointer)
    buffer, where = document.entry("buffers", number)
    marks = document.object(document.object(buffer, "extensions", where), name, where)
    if marks.get("fallback") is not True and (number in document.buffers or "uri" in buffer):
        return
    # Check the JSON description against the rules of the extension.
    where = f"{pointer}/extensions/{name}"
    packed = document.object(extensions, name, f"{pointer}/extensions")
    count, stride = (document.integer(packed, key, where) for key in ("count", "byteStride"))
    mode, filter_ = packed.get("mode"), packed.get("filter", "NONE")
    if mode not in _MODES or filter_ not in _FILTERS:
        text = (
            f"mode {shorten(str(mode))} with filter {shorten(str(filter_))} does not exist in the extension"
        )
        raise document.error("MESH_FILE_INVALID", where, text)
    valid = 0 < stride <= 256 and stride % 4 == 0 if mode == "ATTRIBUTES" else stride in (2, 4)
    if not valid or (mode == "TRIANGLES" and count % 3) or (mode != "ATTRIBUTES" and filter_ != "NONE"):
        text = f"{count} elements of {stride} bytes are invalid for mode {mode} with filter {filter_}"
        raise document.error("MESH_FILE_INVALID", where, text)
    if count * stride != document.integer(view, "byteLength", pointer):
        text = f"{count} elements of {stride} bytes do not match the {view['byteLength']} bytes of the view"
        raise document.error("MESH_FILE_INVALID", where, text)
    data = document.bytes_of(packed, where)
    job = {"pointer": pointer, "view": index, "data": data, "bytes": count * stride}
    if count:
        yield job | {"count": count, "stride": stride, "mode": mode, "filter": filter_}
    else:
        document.views[index] = memoryview(b"")


def _make_draco_job(
    document: Document, primitive: dict[str, Any], packed: dict[str, Any], pointer: str
) -> Job:
    """Return the job for a compressed primitive.

    The argument `packed` is the extension object of the primitive.
    """
    where = f"{pointer}/extensions/{DRACO}"
    data, _, _ = document.view(document.integer(packed, "bufferView", where))
    numbers = document.object(packed, "attributes", where)
    names = [name for name in numbers if name.startswith(_READ) or name in _EXPLAINING]
    names = [name for name in names if name not in _EXPLAINING or type(numbers[name]) is int]
    attributes = {name: document.integer(numbers, name, f"{where}/attributes") for name in names}
    if "POSITION" not in attributes:
        raise document.error("MESH_FILE_INVALID", where, "the attributes have no POSITION")
    # The decoded arrays must have the lengths that their accessors declare.
    accessors = document.object(primitive, "attributes", pointer)
    counts = {name: _find_accessor(document, accessors.get(name)).get("count") for name in attributes}
    counts["indices"] = _find_accessor(document, primitive.get("indices")).get("count")
    for name in _EXPLAINING:
        if counts.get(name) != counts["POSITION"]:
            counts.pop(name, None)
            attributes.pop(name, None)
    for name, count in counts.items():
        if type(count) is not int or count < 0:
            text = f"{name} has no accessor with a 'count'"
            raise document.error("MESH_FILE_INVALID", where, text)
    return {
        "pointer": pointer,
        "mode": "DRACO",
        "data": data,
        "attributes": attributes,
        "counts": counts,
        "bytes": 16 * sum(count or 0 for count in counts.values()),
    }


def _store_primitive(document: Document, job: Job, number: int, arrays: Arrays) -> None:
    """Check the lengths of the decoded arrays of a primitive, and store the arrays."""
    stored = {}
    for name, count in job["counts"].items():
        array = arrays.get(f"{number}.{name}", np.zeros((0, 1)))
        if name == "indices":
            array = array.reshape(-1, 1)
        if len(array) != count and name in _EXPLAINING:
            continue
        if len(array) != count:
            text = f"the accessor of {name} declares {count} elements, but {len(array)} were decoded"
            raise document.error("MESH_FILE_INVALID", job["pointer"], text)
        stored[name] = array
    document.packed[job["pointer"]] = stored
