"""Seeds: shipped stubs, files built by the tests, and their bad files."""

from __future__ import annotations

import base64
import gzip
import hashlib
import io
import json
import struct
import zipfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from data_stubs.torch_file import write_torch
from data_stubs.training.state import write_state
from msb.meshes import Mesh, write_mesh
from msb.meshes.formats import list_written_suffixes
from tests.adapters import assemble, models
from tests.adapters.bad_checkpoints import CASES as BAD_CHECKPOINTS
from tests.adapters.bad_pickles import CASES as BAD_PICKLES
from tests.conftest import ROOT
from tests.corpus.forge import forge
from tests.corpus.good import decoder, mesh, parts, soup
from tests.meshes.bad_files import BAD as BAD_MESHES
from tests.meshes.builders import SMALL as MESHES
from tests.meshes.builders import SQUARE, SQUARE_FACES, glb_file, glb_square
from tests.scenes.bad_cameras import BAD as BAD_CAMERAS
from tests.scenes.bad_cameras import SMALL as CAMERAS
from tests.splats.builders import FILES as SPLATS
from tests.splats.builders import gaussians, sog_files

STUBS = ROOT / "tests" / "tiny"
MODELS = STUBS / "models" / "pebble"

MATLAB = ("ObsMask1_10.mat", "Plane1.mat")


def assets() -> list[bytes]:
    return [forge(parts(make()).entries()) for make in (mesh, soup, decoder)]


def manifests() -> list[bytes]:
    return [parts(make()).text() for make in (mesh, soup, decoder)]


def around_manifest(text: bytes) -> bytes:
    return forge(parts(soup()).entries(text))


def checkpoints() -> Iterator[bytes]:
    yield from (assemble.archive(), assemble.legacy())
    yield from (case.make() for case in BAD_CHECKPOINTS)
    yield from (file.read_bytes() for file in sorted((ROOT / "tests/golden/checkpoints").glob("*.pt")))


def pickles() -> Iterator[bytes]:
    """Return programs of the pickle machine: valid programs, and the corpus."""
    yield assemble.GOOD
    for case in BAD_PICKLES:
        try:
            with zipfile.ZipFile(io.BytesIO(case.make())) as archive:
                yield from (archive.read(name) for name in archive.namelist() if name.endswith("data.pkl"))
        except (OSError, ValueError, RuntimeError, zipfile.BadZipFile):
            continue  # this case is not a program


@cache
def model(method: str) -> tuple[bytes, dict[str, bytes]]:
    """Return the program and the storages of a small good model."""
    values = models.VALUES[method]()
    stream: Any = io.BytesIO()
    write_torch(stream, (values, {}, None, 1.0) if method == "two_dts" else values)
    with zipfile.ZipFile(stream) as archive:
        members = {name.partition("/")[2]: archive.read(name) for name in archive.namelist()}
    storages = {name[5:]: data for name, data in members.items() if name.startswith("data/")}
    return members["data.pkl"], storages


def configs() -> list[bytes]:
    more = b"model:\n  target: a.B\n  init_args: {sh_degree: 3, gamma: 1e1, x: [1, ~, .nan, 2020-01-01]}\n"
    return [
        (MODELS / "two_dts/config.yaml").read_bytes(),
        more,
        b"a: &a [1]\nmodel: {b: *a}\n",
        b"? [a]\n: b",
    ]


def log(config: bytes) -> bytes:
    return b"config args:\n" + b"=" * 40 + b"\n" + config + b"\n" + b"=" * 40 + b"\n"


@cache
def web_export() -> dict[str, bytes]:
    with TemporaryDirectory() as name:
        folder = models.write_web_export(Path(name) / "web")
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def meshes(suffix: str) -> Iterator[bytes]:
    """Return small meshes of a format, valid and broken.

    If we write the format, one of them is written by us.
    """
    if suffix in list_written_suffixes():
        stream = io.BytesIO()
        write_mesh(Mesh(np.array(SQUARE), np.array(SQUARE_FACES)), stream, suffix=suffix)
        yield stream.getvalue()
    yield from (content for key, content in MESHES.items() if key.lower() == suffix)
    yield from (content for key, content, *_ in BAD_MESHES.values() if key.lower() == suffix)


def splats(*names: str) -> list[bytes]:
    """Return valid files of Gaussians by their names."""
    return [SPLATS[name](20) for name in names]


def spz_columns() -> list[bytes]:
    """Return the decompressed content of .spz files; `gzip.compress` packs a mutated one."""
    return [gzip.decompress(SPLATS[name](20)) for name in ("v1.spz", "v2.spz", "v3.spz")]


def sog_texts() -> list[bytes]:
    return [sog_files(gaussians(1, count=40), version)["meta.json"] for version in (1, 2)]


def around_meta(text: bytes) -> bytes:
    """Return a .sog with this meta.json and valid images."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in {**sog_files(gaussians(1, count=40)), "meta.json": text}.items():
            archive.writestr(name, data)
    return stream.getvalue()


def packed() -> list[bytes]:
    from tests.meshes.test_gltf_packed import by_draco, by_meshopt, plain

    return [each.bytes() for each in (by_meshopt(plain()), by_meshopt(plain(quantized=True)), by_draco())]


def materials() -> list[bytes]:
    return [
        b"newmtl one\nKd 0.5 0.5 0.5\nmap_Kd -s 1 1 -o 0 map.png\nd 0.5\n",
        b"newmtl one\r\n Kd 1 0.5 0\r\nmap_bump -bm 1 .\\map.png\n# end",
        b"newmtl two\n\nnewmtl one\nmap_Kd ../map.png",
    ]


def glb_texts() -> Iterator[bytes]:
    """Return the JSON chunks of the GLB seeds."""
    for content in meshes(".glb"):
        if len(content) >= 20:
            yield content[20 : 20 + struct.unpack_from("<I", content, 12)[0]]


def around_gltf(text: bytes) -> bytes:
    content = glb_square().bytes()
    return glb_file(text, content[20 + struct.unpack_from("<I", content, 12)[0] + 8 :])


def cameras(kind: str, file: str) -> Iterator[bytes]:
    """Return contents of one file of a camera source, valid and broken."""
    yield CAMERAS[kind][file]
    yield from (files[file] for files, *_ in BAD_CAMERAS.values() if file in files)


def matrices() -> list[bytes]:
    stream = io.BytesIO()
    np.savez(stream, world_mat_0=np.diag([5.0, 5, 1, 1]), scale_mat_0=np.eye(4))
    return [stream.getvalue(), (STUBS / "scenes/dtu/scan1/cameras.npz").read_bytes()]


def pictures(suffix: str) -> list[bytes]:
    from PIL import Image

    pixels = np.random.default_rng(0).integers(0, 256, (6, 9, 4), dtype=np.uint8)
    found = []
    kinds = {"png": ("1", "L", "LA", "P", "RGB", "RGBA", "I;16"), "jpg": ("L", "RGB", "CMYK")}
    kinds["webp"] = ("RGB", "RGBA")
    for mode in kinds[suffix]:
        if mode == "I;16":
            picture = Image.fromarray(pixels[..., 0].astype(np.uint16))
        else:
            picture = Image.fromarray(pixels).convert("RGB").convert(mode)
        for more in {"jpg": ({}, {"progressive": True}), "webp": ({}, {"lossless": True})}.get(suffix, ({},)):
            stream = io.BytesIO()
            picture.save(stream, {"png": "PNG", "jpg": "JPEG", "webp": "WEBP"}[suffix], **more)
            found.append(stream.getvalue())
    return found


def npy_images() -> list[bytes]:
    found = []
    for array in (np.zeros((2, 3, 3), np.uint8), np.zeros((2, 3, 3), "<f4"), np.zeros((2, 3, 3), ">f8", "F")):
        stream = io.BytesIO()
        np.save(stream, array)
        found.append(stream.getvalue())
    return found


def exr_images() -> list[bytes]:
    from msb.render.images import write_image

    with TemporaryDirectory() as name:
        path = Path(name) / "a.exr"
        write_image(path, np.full((2, 3, 3), 0.5, np.float32), "exr")
        return [path.read_bytes()]


def dtu_files() -> dict[str, bytes]:
    cloud = b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"".join(
        b"property float %c\n" % axis for axis in b"xyz"
    )
    return {
        **{f"ObsMask/{name}": (STUBS / "scenes/dtu/ObsMask" / name).read_bytes() for name in MATLAB},
        "Points/stl/stl001_total.ply": cloud + b"end_header\n1 2 3\n",
    }


def vgg_archives() -> list[bytes]:
    stream = io.BytesIO()
    np.savez(stream, **{"features.0.weight": np.zeros((1, 1), "<f4"), "features.0.bias": np.zeros(64, "<f4")})
    return [stream.getvalue()]


def protocols() -> list[bytes]:
    from tests.bench.test_protocol import MINIMAL, WRONG

    return [(STUBS / "protocol.toml").read_bytes(), MINIMAL.encode(), *(text.encode() for text in WRONG)]


def gates() -> list[bytes]:
    from msb.api.gates import PROFILES

    return [gate.encode() for gates in PROFILES.values() for gate in gates]


def results() -> list[bytes]:
    from msb.bench.documents import STORED, RepairDocument, TrialDocument
    from msb.bench.records import CONDITIONS
    from tests.report.factory import TASK, make_result, repairs, strategy_json, trial

    made = [make_result("capture", "desk", "two_dts", condition) for condition in CONDITIONS]
    mesh = make_result("capture", "desk", "mesh_splatting", "exported_mesh")
    tried = {
        "trial": TrialDocument.of(trial(TASK)),
        "repairs": RepairDocument.of(repairs(strategy_json(STORED))),
    }
    variant = made[CONDITIONS.index("dedicated")]
    made += [
        make_result("dtu", "scan24", "two_dts", "non_engine", renderer_timing=timing()),
        mesh.model_copy(update=tried),
        variant.model_copy(update={"cell": variant.cell.model_copy(update={"variant": "a", "label": "b"})}),
    ]
    return [result.to_json() for result in made]


def submissions() -> list[bytes]:
    from msb.bench.submission import SubmittedImage, write_submission
    from tests.report.factory import make_result

    records = [
        make_result("capture", "desk", "two_dts", condition) for condition in ("dedicated", "standard")
    ]
    shown = SubmittedImage(file="0.jpg", dataset="capture", scene="desk", image="0.png", why="a photograph")
    return [write_submission("A", records, [(shown, jpeg)]) for jpeg in pictures("jpg")[:1]]


def around_record(record: bytes) -> bytes:
    """Return a submission of one record with the right hash."""
    from msb.bench.submission import ABOUT, About, make_archive

    name = "records/00000.json"
    files = {name: hashlib.sha256(record).hexdigest()}
    about = About(name="A", tool_version="1", code_sha256="0" * 64, commands=(), files=files, pictures=())
    return make_archive({ABOUT: about.to_json(), name: record})


def timing() -> Any:
    from msb.bench.records import RendererTiming

    return RendererTiming(frames=300, seconds=2.5, device="GPU", timed="render()")


def renderer_timings() -> list[bytes]:
    return [timing().to_json()]


@cache
def pages() -> list[bytes]:
    """Return the parts of a page that are read again, its scene and its test views, for each storage of
    arrays.
    """
    from msb.engines.dedicated_page.storage import store

    view = {"width": 5, "height": 3}
    image = np.arange(45, dtype=np.uint8).reshape(15, 3)
    stored = store(image)
    tests = [{"name": "0", "view": view, "image": "test 0"}]
    scene = {"dedicated": {"tests": tests, "arrays": {"test 0": stored.head}}}
    return [
        b'<script type="application/json" id="scene">%b</script>'
        b'<script type="text/plain" data-array="test 0">%b</script></body>'
        % (json.dumps(scene).encode(), base64.b64encode(stored.data))
    ]


def trainings() -> list[bytes]:
    with TemporaryDirectory() as name:
        path = Path(name) / "training.npz"
        write_state(path, {"pixel": np.ones(3), "adam/steps": np.array(1)}, {"method": "two_dts"})
        return [path.read_bytes()]


def tracks() -> list[bytes]:
    from msb.bench.track import Track

    time = "2026-01-01T00:00:00+00:00"
    known = Track(
        command=("train",),
        started=time,
        ended=time,
        seconds=1.5,
        exit_status=0,
        peak_gpu_memory_bytes=None,
        gpu_source=None,
        gpu_reason="no GPU",
        gpus=(),
        peak_host_memory_bytes=1 << 20,
        interval_seconds=0.2,
        machine={"cores": 2},
        tool_version="0.1.0",
    )
    return [known.to_json()]


def published() -> list[bytes]:
    cell = {"dataset": "dtu", "scene": "24", "method": "2dts", "condition": "dedicated", "metric": "psnr"}
    return [json.dumps({"schema": "msb-paper-table/1", "cells": [cell | {"value": 20.5}]}).encode()]


def benchmarks() -> list[bytes]:
    from msb.bench.commands.bench import SCHEMA

    tables = {
        "device_ms": {"p50": 1.5},
        "busy_ms": {"p50": 1.0},
        "stages_ms": {"a": 1},
        "memory_bytes": {"b": 2},
    }
    return [json.dumps({"schema": SCHEMA, "fps": 10, **tables}).encode()]


def stub(*names: str) -> Callable[[], Iterable[bytes]]:
    """Return a function that returns the contents of shipped files."""
    return lambda: [(STUBS / name).read_bytes() for name in names]
