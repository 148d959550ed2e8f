"""Arrays of glTF that are stored compressed: by meshopt, view by view, and by Draco, primitive by primitive.

The decoders are other people's C++, so they run in a process of its own: what crashes there is one line here,
and what takes more memory than the file says that its arrays need is ended.
"""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays, run_apart
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import shorten
from msb.meshes.gltf import Document

MESHOPT = ("KHR_meshopt_compression", "EXT_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
# How the names of attributes begin that are read.
_READ = ("POSITION", "COLOR_0", "TEXCOORD_")
_SECONDS = 300
# Memory of the process: a GiB, and 16 times what the arrays take.
_GIB, _GIB_EACH = 1.0, 16.0
Job = dict[str, Any]


def unpack(document: Document, meshes: list[int]) -> None:
    """Decode what of these `meshes` is stored compressed alone, into at most `document.limit` bytes.

    Views land in `document.views`, attributes and indices of primitives in `document.packed`.
    """
    jobs = list(_jobs(document, meshes))
    if not jobs:
        return
    # The buffers that the jobs need have been read: they count as bytes of the file.
    total = sum(job["bytes"] for job in jobs)
    document.check_total("its compressed arrays", total)
    modules = sorted({"DracoPy" if job["mode"] == "DRACO" else "meshopt" for job in jobs})
    need_extra("compressed", *modules, what=f"the compressed mesh in {shorten(document.source.path, 200)}")
    data = [job.pop("data") for job in jobs]
    ends = np.cumsum([len(each) for each in data]).tolist()
    for job, end, each in zip(jobs, ends, data, strict=True):
        job["place"] = [end - len(each), end]
    joined = np.frombuffer(b"".join(data) + b"\0", np.uint8)
    plan = np.frombuffer(json.dumps(jobs).encode(), np.uint8)
    limits = Limits(_SECONDS, _GIB + _GIB_EACH * total / 2**30)
    reply = run_apart(unpack_here, "", {"plan": plan, "data": joined}, limits)
    if reply.why:
        raise document.source.error(
            "MESH_FILE_INVALID", f"its compressed arrays cannot be decoded: {reply.why}"
        )
    for number, job in enumerate(jobs):
        if job["mode"] == "DRACO":
            _keep_primitive(document, job, number, reply.arrays)
        else:
            document.views[job["view"]] = memoryview(reply.arrays[f"{number}"].tobytes())


def unpack_here(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Decode all jobs of the plan in `arrays`; a `Work` of `msb.base.children`."""
    made: dict[str, NDArray[Any]] = {}
    for number, job in enumerate(json.loads(arrays["plan"].tobytes())):
        data = arrays["data"][slice(*job["place"])].tobytes()
        try:
            if job["mode"] == "DRACO":
                made |= {f"{number}.{name}": array for name, array in _draco(job, data)}
            else:
                import meshopt

                shape = job["count"], job["stride"]
                rows = meshopt.decode_gltf_buffer(data, *shape, job["mode"], job["filter"])
                made[f"{number}"] = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
        except MemoryError:
            raise
        except Exception as error:
            text = f"{job['pointer']}: {error or type(error).__name__}"
            raise ValueError(text) from error
    return None, made


def _draco(job: Job, data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    import DracoPy

    mesh = DracoPy.decode(data)
    yield "indices", np.ascontiguousarray(mesh.faces)
    for name, number in job["attributes"].items():
        found = mesh.get_attribute_by_unique_id(number)
        if found is None:
            message = f"there is no attribute {number}, which should be {name}"
            raise ValueError(message)
        yield name, np.ascontiguousarray(found["data"])


def _jobs(document: Document, meshes: list[int]) -> Iterator[Job]:
    """Yield what is to be decoded: views, each once, and primitives."""
    views: set[int] = set()
    for mesh in meshes:
        owner, where = document.entry("meshes", mesh)
        for number, primitive in enumerate(document.array(owner, "primitives", where)):
            pointer = f"{where}/primitives/{number}"
            if not isinstance(primitive, dict):
                continue  # whoever reads it says so
            attributes = document.object(primitive, "attributes", pointer)
            wanted = {name: each for name, each in attributes.items() if name.startswith(_READ)}
            packed = document.object(document.object(primitive, "extensions", pointer), DRACO, pointer)
            if packed and "bufferView" not in _accessor(document, wanted.get("POSITION")):
                yield _draco_job(document, primitive, packed, pointer)
                continue
            for each in (*wanted.values(), primitive.get("indices")):
                views |= _views_of(document, each)
    for view in sorted(views):
        yield from _meshopt_jobs(document, view)


def _accessor(document: Document, number: Any) -> dict[str, Any]:
    """Return an accessor; one that is not there is empty, and whoever reads it says so."""
    entries = document.array(document.root, "accessors", "")
    there = type(number) is int and 0 <= number < len(entries) and isinstance(entries[number], dict)
    return entries[number] if there else {}


def _views_of(document: Document, number: Any) -> set[int]:
    """Return the views that an accessor reads."""
    entry = _accessor(document, number)
    sparse = entry.get("sparse")
    parts = [sparse.get("indices"), sparse.get("values")] if isinstance(sparse, dict) else []
    found = [each.get("bufferView") for each in (entry, *parts) if isinstance(each, dict)]
    count = len(document.array(document.root, "bufferViews", ""))
    return {each for each in found if type(each) is int and 0 <= each < count}


def _meshopt_jobs(document: Document, index: int) -> Iterator[Job]:
    """Yield the job of a view, if what it holds is there compressed alone."""
    view, pointer = document.entry("bufferViews", index)
    extensions = document.object(view, "extensions", pointer)
    name = next((each for each in MESHOPT if each in extensions), None)
    if name is None:
        return
    number = document.integer(view, "buffer", pointer)
    buffer, where = document.entry("buffers", number)
    said = document.object(document.object(buffer, "extensions", where), name, where)
    if said.get("fallback") is not True and (number in document.buffers or "uri" in buffer):
        return
    where = f"{pointer}/extensions/{name}"
    packed = document.object(extensions, name, f"{pointer}/extensions")
    count, stride = (document.integer(packed, key, where) for key in ("count", "byteStride"))
    mode, filter_ = packed.get("mode"), packed.get("filter", "NONE")
    if mode not in _MODES or filter_ not in _FILTERS:
        text = f"mode {shorten(str(mode))} with filter {shorten(str(filter_))} is not in the extension"
        raise document.error("MESH_FILE_INVALID", where, text)
    right = 0 < stride <= 256 and stride % 4 == 0 if mode == "ATTRIBUTES" else stride in (2, 4)
    if not right or (mode == "TRIANGLES" and count % 3) or (mode != "ATTRIBUTES" and filter_ != "NONE"):
        text = f"{count} elements of {stride} bytes cannot be {mode} with filter {filter_}"
        raise document.error("MESH_FILE_INVALID", where, text)
    if count * stride != document.integer(view, "byteLength", pointer):
        text = f"{count} elements of {stride} bytes are not the {view['byteLength']} bytes of the view"
        raise document.error("MESH_FILE_INVALID", where, text)
    data = document.bytes_of(packed, where)
    about = {"pointer": pointer, "view": index, "data": data, "bytes": count * stride}
    if count:
        yield about | {"count": count, "stride": stride, "mode": mode, "filter": filter_}
    else:
        document.views[index] = memoryview(b"")


def _draco_job(document: Document, primitive: dict[str, Any], packed: dict[str, Any], pointer: str) -> Job:
    where = f"{pointer}/extensions/{DRACO}"
    data, _, _ = document.view(document.integer(packed, "bufferView", where))
    numbers = document.object(packed, "attributes", where)
    names = [name for name in numbers if name.startswith(_READ)]
    attributes = {name: document.integer(numbers, name, f"{where}/attributes") for name in names}
    if "POSITION" not in attributes:
        raise document.error("MESH_FILE_INVALID", where, "there is no POSITION among its attributes")
    given = document.object(primitive, "attributes", pointer)
    counts = {name: _accessor(document, given.get(name)).get("count") for name in attributes}
    counts["indices"] = _accessor(document, primitive.get("indices")).get("count")
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


def _keep_primitive(document: Document, job: Job, number: int, arrays: Arrays) -> None:
    """Keep the arrays of a primitive, which have as many elements as their accessors say."""
    kept = {}
    for name, count in job["counts"].items():
        array = arrays[f"{number}.{name}"]
        if name == "indices":
            array = array.reshape(-1, 1)
        if len(array) != count:
            text = f"its accessor says that {name} has {count} elements; {len(array)} are stored, compressed"
            raise document.error("MESH_FILE_INVALID", job["pointer"], text)
        kept[name] = array
    document.packed[job["pointer"]] = kept
