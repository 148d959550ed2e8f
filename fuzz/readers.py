"""Calls of each reader: functions of a path, whose return value is ignored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from msb.errors import shorten


def asset(path: Path) -> None:
    """Validate and load; check that buffers match the manifest and are read-only."""
    from msb.asset import load, validate
    from msb.asset.manifest import DTYPES

    whole = validate(path).asset is not None
    asset = load(path)
    manifest = asset.manifest
    counts = {"vertex": manifest.vertex_count, "face": manifest.face_count, "corner": 3 * manifest.face_count}
    assert whole
    assert min(counts.values()) > 0
    assert {"positions", "indices"} <= set(asset.buffers) == set(manifest.buffers)
    for name, spec in manifest.buffers.items():
        array = asset.buffers[name]
        assert array.size > 0
        assert (array.shape, array.nbytes, array.dtype) == (spec.shape, spec.byte_length, DTYPES[spec.dtype])
        assert not array.flags.writeable
        assert spec.domain == "global" or len(array) == counts[spec.domain]


def checkpoint(path: Path) -> None:
    """Read, and visit every value like a careless user, who visits shared values several times."""
    from msb.adapters.checkpoint import read_checkpoint as read

    _touch(read(path), path.stat().st_size)


def _touch(value: Any, size: int) -> None:
    from msb.adapters.checkpoint import BFloat16Array

    if isinstance(value, BFloat16Array):
        value = value.bits
    if isinstance(value, np.ndarray):
        assert not value.flags.writeable
        assert value.nbytes <= size
        value.tobytes()
    elif isinstance(value, dict):
        for key, item in value.items():
            assert type(key) in (str, int)
            _touch(item, size)
    elif isinstance(value, list | tuple):
        for item in value:
            _touch(item, size)
    else:
        assert value is None or type(value) in (str, int, float, bool, bytes)


def submission(path: Path) -> None:
    from msb.bench.submission import read_submission as read

    read(path)


def export(path: Path, method: str | None = None) -> None:
    from msb.adapters.exporter import export as make

    make(path, method=method)


def two_dts_config(path: Path) -> None:
    from msb.methods.two_dts.adapter import read_config as read

    read(path.parent, path)


def cfg_args(path: Path) -> None:
    from msb.adapters.training_config import read_cfg_args as read

    read(path.parent)


def mesh(path: Path) -> None:
    """Read a mesh. Arrays are decoded in this process, because the guard forbids child processes."""
    from unittest.mock import patch

    from msb.meshes import read_mesh as read

    with patch("msb.meshes.gltf_packed.run_in_child", run_here):
        read(path)


def run_here(work: Any, word: str, arrays: Any, limits: Any) -> Any:
    from msb.base.children import Reply

    try:
        return Reply(*work(word, arrays))
    except Exception as error:
        return Reply(why=shorten(str(error), 200))


def materials(path: Path) -> None:
    mesh(path.with_suffix(".obj"))


def texture(path: Path) -> None:
    """Decode an image; check its size against the declared size and the limit."""
    from msb.asset.texture import MAX_SIDE
    from msb.meshes.images import Decoder

    image = Decoder().decode(path.read_bytes(), alpha=True)
    assert image.dtype == np.uint8
    assert image.ndim == 3
    assert image.shape[2] in (3, 4)
    assert 0 < max(image.shape[:2]) <= MAX_SIDE


def cameras(path: Path) -> None:
    from msb.scenes import read_cameras as read

    read(path)


def camera_folder(path: Path) -> None:
    cameras(path.parent)


def points(path: Path) -> None:
    from msb.scenes import read_points as read

    read(path)


def views(path: Path) -> None:
    from msb.scenes import read_views as read

    read(path)


def neus(path: Path) -> None:
    from msb.scenes.datasets import read_matrices
    from msb.scenes.datasets.neus import decompose

    for world, scale in zip(*read_matrices(path), strict=True):
        decompose(world @ scale)


def image(path: Path) -> None:
    from msb.metrics import read_image as read

    read(path, background=(0, 0, 0))


def size_of_image(path: Path) -> None:
    from msb.scenes import image_size

    image_size(path)


def mask(path: Path) -> None:
    from msb.metrics.image_files import read_mask as read

    read(path)


def dtu(path: Path) -> None:
    from msb.metrics import read_dtu_scan

    read_dtu_scan(next(folder for folder in path.parents if (folder / "ObsMask").is_dir()), 1)


def vgg(path: Path) -> None:
    from msb.metrics.vgg import read_vgg as read

    read(path)


def protocol(path: Path) -> None:
    from msb.bench.protocol import read_protocol as read

    read(path)


def gate(path: Path) -> None:
    from msb.api.gates import parse_gate

    parse_gate(path.read_bytes().decode("utf-8", "replace"))


def report(path: Path) -> None:
    """Read a results folder with one record and create its tables, pages and findings, without figures."""
    from msb.bench.records import read_result
    from msb.report.collect import collect
    from msb.report.findings import derive_findings
    from msb.report.mesh_trials import read_repairs, read_task_outcomes
    from msb.report.results import LoadedResult, result_set
    from msb.report.tables.asset import asset_tables, provenance

    results = result_set([LoadedResult(read_result(path), path, path.parents[5])])
    numbers = collect(results)
    derive_findings(numbers)
    for place, conditions in results.places.items():
        records = {condition: loaded.result for condition, loaded in conditions.items()}
        asset_tables(place, records, numbers)
        provenance(records)
        for loaded in conditions.values():
            read_task_outcomes(loaded)
            read_repairs(loaded)
            for image in () if loaded.result.quality is None else loaded.result.quality.images:
                loaded.file(image.file)


def track(path: Path) -> None:
    from msb.bench.track import read_track as read

    read(path)


def renderer_timing(path: Path) -> None:
    from msb.bench.records import read_renderer_timing as read

    assert read(path).fps > 0


def page(path: Path) -> None:
    """Read a page of the dedicated tier, and check that its images match its test views."""
    from msb.engines.dedicated_page.page import read_page as read

    _, scene, images = read(path)
    for test, image in zip(scene["dedicated"]["tests"], images, strict=True):
        assert image.shape == (test["view"]["height"], test["view"]["width"], 3)
        assert image.dtype == np.uint8


def training(path: Path) -> None:
    """Read the state of a training. Its arrays must not be larger than its file."""
    from data_stubs.training.state import read_state as read

    arrays, _ = read(path)
    assert sum(array.nbytes for array in arrays.values()) <= path.stat().st_size


def published(path: Path) -> None:
    from msb.report.paper import published_numbers

    published_numbers(path)


def benchmark(path: Path) -> None:
    from msb.bench.commands.bench import _read_old

    _read_old(path)
