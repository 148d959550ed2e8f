"""Small protocols on the shipped scenes, and functions that read results without times."""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from msb.bench.protocol import ProtocolFile, parse_protocol
from msb.bench.records import read_result
from msb.bench.run import Report, Watch
from msb.render.machine import OF_THE_MOMENT
from tests.conftest import ROOT

STUBS = ROOT / "tests" / "tiny"
PEBBLE = STUBS / "models" / "pebble"
TIMES = {"seconds", "timing", "floor", "timings_ms", "stages_ms", *OF_THE_MOMENT}


def make_protocol(
    folder: Path,
    methods: tuple[str, ...] = ("two_dts", "diffsoup"),
    *,
    dataset: str = "nerf_synthetic",
    head: str = "",
    keys: str = "",
    tail: str = "",
) -> ProtocolFile:
    """Return a protocol that runs the methods on one scene and times two frames.

    Its results go below `folder`; no file is written.

    The text `head` comes first, `keys` are added to every method, and the text `tail` comes last.
    """
    lines = [
        head,
        "[timing]",
        "frames = 2",
        "seconds = 0.0",
        "[[datasets]]",
        f'name = "{dataset}"',
        f"path = {json.dumps(str(STUBS / 'scenes' / dataset))}",
    ]
    for method in methods:
        lines += [
            "[[methods]]",
            f'name = "{method}"',
            f"model = {json.dumps(str(PEBBLE / '{method}'))}",
            keys,
        ]
    return parse_protocol("\n".join([*lines, tail]).encode(), folder / "protocol.toml")


def change_tables(
    file: ProtocolFile, *, method: Any = None, dataset: Any = None, alone: bool = False, **tables: Any
) -> ProtocolFile:
    """Return the protocol with tables replaced; a mapping replaces keys of a table.

    `method` and `dataset` replace keys of the first method and dataset; with `alone` the others are removed.
    """
    protocol = file.protocol
    for name, keys in (("methods", method), ("datasets", dataset)):
        if keys is not None:
            first, *others = getattr(protocol, name)
            tables[name] = (first.model_copy(update=keys), *([] if alone else others))
    for name, value in tables.items():
        if isinstance(value, dict):
            tables[name] = getattr(protocol, name).model_copy(update=value)
    return replace(file, protocol=protocol.model_copy(update=tables))


class Notes(Watch):
    """Collects the notes of a run."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


def wait_until(condition: Callable[[], object]) -> None:
    """Wait until a condition is true, for at most a minute."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "the condition did not become true"
        time.sleep(0.05)


def read_records(results: Path) -> dict[str, Any]:
    """Return the records below a results folder by path, without times and without the path of the folder."""
    text = {path: path.read_text() for path in sorted(results.rglob("result.json"))}
    return {
        path.relative_to(results).as_posix(): _timeless(json.loads(content.replace(str(results), "RESULTS")))
        for path, content in text.items()
    }


def find_differences(first: Any, second: Any, place: str = "") -> list[str]:
    """Return the differences of two JSON values as lines "place: first value, second value"."""
    if isinstance(first, dict) and isinstance(second, dict):
        keys = dict.fromkeys((*first, *second))
        pairs = [(key, first.get(key, "absent"), second.get(key, "absent")) for key in keys]
    elif isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        pairs = [(number, *both) for number, both in enumerate(zip(first, second, strict=True))]
    else:
        return [] if first == second else [f"{place}: {str(first)[:200]}, {str(second)[:200]}"]
    return [line for key, a, b in pairs for line in find_differences(a, b, f"{place}/{key}")]


def read_images(results: Path) -> dict[str, bytes]:
    """Return the content of every image below a results folder, by path."""
    files = sorted(results.rglob("*.png"))
    return {path.relative_to(results).as_posix(): path.read_bytes() for path in files}


def _timeless(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _timeless(value) for key, value in data.items() if key not in TIMES}
    return [_timeless(value) for value in data] if isinstance(data, list) else data


def read_cell(file: ProtocolFile, name: str) -> Any:
    """Return the record "METHOD/CONDITION" of the scene pebble."""
    return read_result(file.results / "cells" / "nerf_synthetic" / "pebble" / name / "result.json")


def get_plan(report: Report) -> dict[str, Any]:
    """Return by "model/condition" the status, or the parts to compute and the reason for each part."""
    return {
        "/".join(row.planned.cell.names[2:]): dict(row.planned.why) or row.planned.status
        for row in report.rows
    }
