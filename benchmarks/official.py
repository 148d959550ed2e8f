"""Measure an official checkpoint on your machine. One command writes one file that can be shared.

    python -m benchmarks.official CHECKPOINT --scene DIR --device gpu -o garden.json
    python -m benchmarks.official --table garden.json truck.json

The first command takes the output folder of a training, and the capture. It measures export, audit, both
tiers, the loss by cause, and a bake. Tiers are measured in OpenCL and, if wgpu is installed, in WebGPU. With
the capture it also measures the PSNR against the photographs, and against the official renderings in the
folder test/ours_N/renders of the checkpoint. It takes minutes on a graphics card and uses no network.
Finished stages are stored in the file. After an interruption, the same command continues, and repeats failed
stages. The second command prints such files as Markdown tables, as in docs/official.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.official_stages import STAGES, Given, asked, work
from msb.adapters.locate import locate
from msb.asset.strict_json import parse_strict_json
from msb.base.atomic import check_place, new_file
from msb.base.children import run_in_child
from msb.base.files import file_sha256, read_file
from msb.base.limits import Limits
from msb.bench.cell import INTERNAL
from msb.errors import InputError, MsbError, UsageError, shorten
from msb.registry import lookup

SCHEMA = "msb.official/1"
_MAX_BYTES = 1 << 20
_SEEN = 40.0
"""A loss is visible, and is listed, if the PSNR (dB) is below this value."""
_WIDEST = 160
"""Largest number of characters of a table cell. It is limited because the files may come from strangers."""
_LIMITS = Limits(seconds=1800, memory=None)
"""Time limit of one stage in seconds; software renderers need long for a capture."""
OF_CAPTURE = "capture", "official"
"""Stages that need a capture."""
FIRST = "machine", "export", "capture"
"""Stages that identify the model and the machine. If one of them fails, the measurement stops."""
_STEPS = (
    "model",
    "capture",
    "export, s",
    "audit, s",
    "verdict",
    "bake, s",
    "baked, dB",
    "official, dB",
)
_DRAWN = (
    "model",
    "drawn",
    "device",
    "FPS",
    "P50, ms",
    "P95, ms",
    "MB",
    "card, MB",
    "dB",
    "dB to official",
)
_COSTS = "model", "machine", "causes below 40 dB, the worst first"
HELD = """\
- machine: operating system and version, processor, cores, memory; names
  of the OpenCL device, graphics cards and drivers; versions of Python,
  NumPy, PyOpenCL, wgpu and MeshSplatBench
- model: method, SHA-256 of its file, numbers of faces and vertices,
  numeric settings (such as the SH degree), counts of the audit
- capture: number and size of its views, deviations of the training, and
  the names of dataset and scene if the benchmark knows them
- each stage: seconds, memory, frame times, dB, or an error code
It contains no images, paths, file names, user names or host names, and
it is not sent anywhere."""


def measured(given: Given, place: Path) -> dict[str, Any]:
    """Run all stages of a checkpoint and return the record. It is saved to `place` after each stage."""
    stages = [name for name in STAGES if given.scene is not None or name not in OF_CAPTURE]
    found = {name: _stage(name, given) for name in stages if name in FIRST}
    for name, path in (("export", given.checkpoint), ("capture", given.scene)):
        if "failed" in found.get(name, {}):
            raise InputError(
                "FILE_UNREADABLE", "it cannot be read; pass an existing checkpoint and scene", file=path
            )
    head = {
        "schema": SCHEMA,
        "measured": time.strftime("%Y-%m-%d"),
        "machine": found["machine"],
        "model_sha256": file_sha256(locate(given.checkpoint).file),
        "capture": found.get("capture"),
    }
    done = {"export": found["export"]} | _done(place, head)
    for name in stages:
        if name not in FIRST and "failed" in done.get(name, {"failed": ""}):
            done[name] = _stage(name, given)
        record = {**head, "stages": {each: done[each] for each in stages if each in done}}
        with new_file(place) as file:
            file.write(json.dumps(record, indent=1).encode() + b"\n")
    return record


def _stage(name: str, given: Given) -> dict[str, Any]:
    """Run a stage in a separate process and print its outcome. Return the result without messages."""
    print(f"{name:15}", end=" ", flush=True)
    start = time.perf_counter()
    reply = run_in_child(work, asked(name, given), {}, _LIMITS)
    found = reply.data or {"failed": reply.ended_by or INTERNAL, "said": reply.why}
    said = found.pop("said", "")
    print(f"{time.perf_counter() - start:6.1f} s  {said}", flush=True)
    return found


def _done(place: Path, head: dict[str, Any]) -> dict[str, Any]:
    """Return the finished stages in a file, unless its model, capture, machine or versions differ."""
    if not place.exists():
        return {}
    there = read(place)
    if any(there.get(key) != head[key] for key in ("machine", "model_sha256", "capture")):
        text = "it has results of another model, machine, capture or version; pass another file with -o"
        raise UsageError("OUTPUT_EXISTS", text, file=place)
    return dict(there["stages"])


def read(place: Path) -> dict[str, Any]:
    """Return the record in a file."""
    about: dict[str, Any] = {"name": "the record", "error": InputError, "code": "FILE_NOT_RECOGNISED"}
    data = parse_strict_json(read_file(place, _MAX_BYTES), file=place, **about)
    if not (isinstance(data, dict) and data.get("schema") == SCHEMA and isinstance(data.get("stages"), dict)):
        text = f"it was not written by benchmarks.official (schema {SCHEMA})"
        raise InputError("FILE_NOT_RECOGNISED", text, file=place)
    return data


def tables(records: Sequence[dict[str, Any]]) -> str:
    """Return Markdown tables of records: time and memory of tiers and stages, and the loss by cause."""
    try:
        drawn = [row for record in records for row in _drawn(record)]
        blocks = (_DRAWN, drawn), (_STEPS, map(_steps, records)), (_COSTS, map(_costs, records))
        return "\n\n".join("\n".join(_table(heads, rows)) for heads, rows in blocks)
    except (AttributeError, KeyError, TypeError, ValueError) as error:  # the file was changed by hand
        text = f"the record (schema {SCHEMA}) was changed by hand and is invalid: {error!r}"
        raise InputError("FILE_NOT_RECOGNISED", text) from error


def _table(heads: Sequence[str], rows: Any) -> Iterator[str]:
    for cells in (heads, ["---"] * len(heads), *rows):
        yield f"| {' | '.join(shorten(str(cell), _WIDEST).replace('|', '/') for cell in cells)} |"


def _model(record: dict[str, Any]) -> str:
    method, faces = (record["stages"]["export"][key] for key in ("method", "faces"))
    return f"{lookup(method).title}, {faces:,} faces"


def _steps(record: dict[str, Any]) -> list[str]:
    stages, capture = record["stages"], record["capture"] or {}
    audit, bake = (stages.get(name, {}) for name in ("audit", "bake"))
    near = bake.get("psnr", {})
    baked = _number((near.get("photographs") or near.get("native") or {}).get("after_16"), 2)
    return [
        _model(record),
        capture.get("scene") or capture.get("dataset") or "--",
        _number(stages["export"].get("seconds"), 1),
        _number(audit.get("seconds"), 1),
        audit.get("verdict", "--"),
        _number(bake.get("seconds"), 0),
        baked if near.get("photographs") or baked == "--" else f"{baked} against native rendering",
        _number(stages.get("official", {}).get("psnr"), 2),
    ]


def _costs(record: dict[str, Any]) -> list[str]:
    costs = record["stages"].get("why", {}).get("costs", ())
    seen = [one for one in costs if one["db"] is not None and one["db"] < _SEEN]
    order = ", ".join(f"{one['name'].replace('_', ' ')} {one['db']:.1f}" for one in seen)
    return [_model(record), record["machine"].get("machine", "--"), order or "--"]


def _drawn(record: dict[str, Any]) -> Iterator[list[str]]:
    for name, found in record["stages"].items():
        tier, _, renderer = name.partition("/")
        if tier not in ("standard", "dedicated"):
            continue
        head = [_model(record), f"{tier}, {renderer or 'OpenCL'}"]
        if "failed" in found:
            yield [*head, found["failed"], *["--"] * 7]
            continue
        near, card = found.get("psnr", {}), found["gpu_memory"]["bytes"]
        # Events of Rusticl report 0 ms. Treat this as unknown.
        times = {name: value or None for name, value in found["device_ms"].items()}
        yield [
            *head,
            found["device"]["name"],
            _number(found["fps"], 1),
            _number(times["p50"], 1),
            _number(times["p95"], 1),
            _number(found["memory_bytes"] / 1e6, 0),
            _number(None if card is None else card / 1e6, 0),
            _number(near.get("photographs"), 2),
            _number(near.get("official"), 2),
        ]


def _number(value: float | None, digits: int) -> str:
    return "--" if value is None else f"{value:,.{digits}f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the file, or print tables. Return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.official",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "checkpoint",
        nargs="?",
        type=Path,
        metavar="CHECKPOINT",
        help="output folder of a training, as for msb export",
    )
    add("--scene", type=Path, metavar="DIR", help="capture of the training, as for msb run")
    add(
        "--image-folder",
        metavar="NAME",
        help="folder of the training photographs, if not the default of the dataset",
    )
    add("--resolution", type=int, metavar="N", help="the -r of the training, if not the default")
    add("--device", metavar="SELECTOR", help="gpu, cpu, or a device name from msb devices")
    add("-o", "--out", type=Path, default=Path("official.json"), metavar="FILE.json")
    add("--table", nargs="+", type=Path, metavar="FILE.json", help="print the tables of such files instead")
    options = parser.parse_args(arguments)
    if (options.checkpoint is None) == (options.table is None):
        parser.error("pass a CHECKPOINT to measure, or --table with files")
    try:
        if options.table:
            print(tables([read(place) for place in options.table]))
            return 0
        check_place(options.out)
        scene = None if options.scene is None else str(options.scene.resolve())
        photographs = options.image_folder, options.resolution
        given = Given(str(options.checkpoint.resolve()), scene, options.device, *photographs)
        print(f"{options.out} will contain only\n{HELD}\n", flush=True)
        print("", tables([measured(given, options.out)]), sep="\n")
    except MsbError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt:
        print(f"\nstopped; run the same command again to continue {options.out}", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
