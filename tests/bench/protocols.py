"""Small protocols on the shipped scenes, and results without what depends on clock and load, to compare."""

import contextlib
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from msb.bench.progress import Stage
from msb.bench.protocol import ProtocolFile, parse_protocol
from msb.bench.records import read_result
from msb.bench.run import Report
from msb.render.machine import OF_THE_MOMENT
from tests.conftest import ROOT

STUBS = ROOT / "tests" / "tiny"
PEBBLE = STUBS / "models" / "pebble"
TIMES = {"seconds", "timing", "floor", "timings_ms", "stages_ms", *OF_THE_MOMENT}


def protocol(
    folder: Path,
    methods: tuple[str, ...] = ("two_dts", "diffsoup"),
    *,
    dataset: str = "nerf_synthetic",
    head: str = "",
    each: str = "",
    tail: str = "",
) -> ProtocolFile:
    """Return a protocol in `folder`: methods on one of the scenes, timed shortly."""
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
            each,
        ]
    return parse_protocol("\n".join([*lines, tail]).encode(), folder / "protocol.toml")


def changed(
    file: ProtocolFile, *, method: Any = None, dataset: Any = None, alone: bool = False, **tables: Any
) -> ProtocolFile:
    """Return the protocol with tables replaced; a mapping replaces keys of a table.

    `method` and `dataset` are keys of the first one, of which it may be `alone`.
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


class Notes:
    """Hears what a run says."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def stage(self, stage: Stage) -> Any:
        return contextlib.nullcontext(lambda _name: None)

    def note(self, text: str) -> None:
        self.said.append(text)


def until(condition: Callable[[], object]) -> None:
    """Wait until something is so, for a minute at most."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)


def records(results: Path) -> dict[str, Any]:
    """Return every record below a results folder by its path, without what is of the moment or the place."""
    text = {path: path.read_text() for path in sorted(results.rglob("result.json"))}
    return {
        path.relative_to(results).as_posix(): _timeless(json.loads(content.replace(str(results), "RESULTS")))
        for path, content in text.items()
    }


def differences(one: Any, other: Any, place: str = "") -> list[str]:
    """Return where two records, or all of two runs, differ: "place: value, other value"."""
    if isinstance(one, dict) and isinstance(other, dict):
        keys = dict.fromkeys((*one, *other))
        pairs = [(key, one.get(key, "absent"), other.get(key, "absent")) for key in keys]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = [(number, *both) for number, both in enumerate(zip(one, other, strict=True))]
    else:
        return [] if one == other else [f"{place}: {str(one)[:200]}, {str(other)[:200]}"]
    return [line for key, first, second in pairs for line in differences(first, second, f"{place}/{key}")]


def images(results: Path) -> dict[str, bytes]:
    """Return every image below a results folder by its path."""
    return {
        path.relative_to(results).as_posix(): path.read_bytes() for path in sorted(results.rglob("*.png"))
    }


def _timeless(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _timeless(value) for key, value in data.items() if key not in TIMES}
    return [_timeless(value) for value in data] if isinstance(data, list) else data


def cell(file: ProtocolFile, name: str) -> Any:
    """Return the record METHOD/COLUMN of the scene pebble, of which any part may be there."""
    return read_result(file.results / "cells" / "nerf_synthetic" / "pebble" / name / "result.json")


def planned(report: Report) -> dict[str, Any]:
    """Return model/condition -> state, or the parts that were computed and why."""
    return {
        "/".join(row.planned.cell.names[2:]): dict(row.planned.why) or row.planned.status
        for row in report.rows
    }
