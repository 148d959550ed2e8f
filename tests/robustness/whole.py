"""Whether what lies in a folder is whole: every file opened by what reads its kind."""

from __future__ import annotations

import csv
import io
import json
import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from msb.asset.validation import validate
from msb.base.atomic import is_leftover
from msb.bench.machine import OF_THE_MOMENT
from msb.bench.records import read_result
from msb.meshes import MESH_SUFFIXES, read_mesh
from tests.robustness.commands import DEMO

NO_OUTPUT = {".lock", ".run.json"}
"""What a run keeps for itself while it lasts (msb/bench/folder.py)."""


def finals(folder: Path) -> Iterator[Path]:
    """Yield every file below `folder` that stands under its final name."""
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and path.name not in NO_OUTPUT and not any(map(is_leftover, parts)):
            yield path


def leftovers(folder: Path) -> list[Path]:
    """Return what writers that were killed left, by the names `msb.base.atomic` gives.

    A writer may be at work: what vanishes meanwhile is passed over, which `Path.rglob` does not do.
    """
    return [
        Path(root, name)
        for root, folders, files in os.walk(folder)
        for name in (*folders, *files)
        if is_leftover(name)
    ]


def check_whole(path: Path) -> None:
    """Read the file; a half one, or one of a kind nothing here writes, raises."""
    checks = {
        ".svg": _drawing,
        ".json": _json,
        ".png": _picture,
        ".jpg": _picture,
        ".gif": _picture,
        ".mp4": _film,
        ".npy": _npy,
        ".npz": _npz,
    }
    checks |= {".html": _page, ".csv": _csv, ".toml": _toml, ".md": _text, ".tex": _text}
    checks |= {".triasset": _asset, **dict.fromkeys(MESH_SUFFIXES, _mesh)}
    if path.parent.name == "buffers" or DEMO in path.parts:
        return  # of an asset in its folder form: its manifest's check reads it; and copies are compared
    if path.name == "manifest.json":
        _asset(path.parent)
    checks[path.suffix](path)


def content(path: Path, folder: Path) -> Any:
    """Return what the file holds, to compare two runs: without times, and without where `folder` is."""
    if path.name == "result.json":
        return _timeless(json.loads(path.read_text("utf-8").replace(str(folder), "FOLDER")))
    if path.suffix == ".mp4":
        return _frames(path)  # its encoder, which has several threads, once found other bytes for equal ones
    data = path.read_bytes()
    if path.suffix == ".json":
        return _timeless(json.loads(data.decode().replace(str(folder), "FOLDER")))
    return data.replace(str(folder).encode(), b"FOLDER")


_TIMES = {"seconds", "timing", "timings_ms", "stages_ms", "stamps", *OF_THE_MOMENT}


def _timeless(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _timeless(value) for key, value in data.items() if key not in _TIMES}
    return [_timeless(value) for value in data] if isinstance(data, list) else data


def _asset(path: Path) -> None:
    found = validate(path)
    assert found.valid, found.findings


def _mesh(path: Path) -> None:
    read_mesh(path)


def _json(path: Path) -> None:
    if path.name == "result.json":
        read_result(path)
    else:
        json.loads(path.read_text("utf-8"))


def _picture(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as picture:
        for frame in range(getattr(picture, "n_frames", 1)):
            picture.seek(frame)
            picture.load()


def _film(path: Path) -> None:
    assert _frames(path)


def _frames(path: Path) -> list[bytes]:
    import av

    with av.open(str(path)) as film:
        frames = [frame.to_ndarray(format="rgb24").tobytes() for frame in film.decode(video=0)]
        assert len(frames) == film.streams.video[0].frames
    return frames


def _npz(path: Path) -> None:
    with np.load(path, allow_pickle=False) as arrays:
        assert {name: arrays[name].dtype.kind for name in arrays} == {
            "vertex": "i",
            "face": "i",
            "turned": "b",
        }


def _npy(path: Path) -> None:
    np.load(path, allow_pickle=False)


def _page(path: Path) -> None:
    text = path.read_text("utf-8")
    assert text.lstrip().lower().startswith("<!doctype html>")
    assert text.rstrip().endswith("</html>")


def _drawing(path: Path) -> None:
    assert path.read_text("utf-8").rstrip().endswith("</svg>")


def _csv(path: Path) -> None:
    rows = list(csv.reader(io.StringIO(path.read_text("utf-8")), strict=True))
    assert rows
    assert len(set(map(len, rows))) == 1


def _toml(path: Path) -> None:
    tomllib.loads(path.read_text("utf-8"))


def _text(path: Path) -> None:
    assert path.read_text("utf-8").endswith("\n")
