"""Compute the parts of one benchmark cell and write its record.

If one part of a benchmark cell fails, the other parts are still computed.
"""

import contextlib
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msb.base.atomic import new_file
from msb.bench.folder import RESULT, Results, check_run
from msb.bench.job import MAIN, Job, JobOutcome, PartName
from msb.bench.parts import (
    measure_audit,
    measure_chamfer,
    measure_repairs,
    measure_timing,
    measure_trial,
    read_native_timing,
    read_training,
)
from msb.bench.quality import measure_quality
from msb.bench.records import Reason, Result
from msb.bench.walk import measure_walk
from msb.errors import MsbError, shorten

# The error code of unexpected exceptions.
INTERNAL = "INTERNAL"
# The function that computes each part of a benchmark cell. Each function returns a dictionary of arguments
# for `Result`.
MEASURES: dict[PartName, Callable[[Job], dict[str, Any]]] = {
    "quality": measure_quality,
    "audit": measure_audit,
    "trial": measure_trial,
    "repairs": measure_repairs,
    "walk": measure_walk,
    "chamfer": measure_chamfer,
    "training": read_training,
    "renderer_timing": read_native_timing,
    "timing": measure_timing,
}
# Keys of `Result` that each part fills. A part without an entry fills the key with its own name.
_KEYS: dict[PartName, tuple[str, ...]] = {
    "quality": ("quality", "setup", "renders", "renderer", "device"),
    "timing": ("timing", "memory", "floor", "device"),
}
# Names of inputs that are not rendering options.
_NOT_RENDERING = frozenset(
    ("cameras", "photographs", "metrics", "device", "clock", "flight", "definition", "film")
)


def compute(job: Job) -> JobOutcome:
    """Compute the requested parts of a benchmark cell, and write its record.

    Valid parts of the earlier record are kept.
    """
    check_run(job.root, job.run)
    start = time.perf_counter()
    record = _keep_valid_parts(job, _read_old(job))
    if any(part in MAIN for part in job.parts):
        # The new images replace the images on disk. Delete the old record first, because it does not describe
        # the new images.
        with contextlib.suppress(FileNotFoundError):
            (job.folder / RESULT).unlink()
    for part, inputs in job.parts.items():
        try:
            filled = MEASURES[part](job)
            if part == "quality" and "timing" in record["inputs"]:
                del filled["device"]  # if the cell has a timing, the record names the device of the timing
            record |= filled
            record["inputs"][part] = dict(inputs)
        except Exception as error:  # an unexpected error in one part must not stop the other parts
            if isinstance(error, MsbError) and error.code == "RUN_SCHEDULER":
                raise
            record["reasons"][part] = make_reason(error)
    record["seconds"] += time.perf_counter() - start
    result = _write(job, record)
    return JobOutcome(job.cell, result.status, time.perf_counter() - start)


def write_lost(job: Job, reason: Reason) -> None:
    """Write the record of a benchmark cell whose worker process died before writing it."""
    old = _read_old(job)
    if old is None or any(part in MAIN for part in job.parts):
        write_result(job.folder, Result(cell=job.cell, status="failed", reason=reason, seconds=0.0))
        return
    record = _keep_valid_parts(job, old)
    record["reasons"] |= dict.fromkeys(job.parts, reason)
    _write(job, record)


def _write(job: Job, record: dict[str, Any]) -> Result:
    """Write the record of a benchmark cell with the parts in `record`, and return the record."""
    failed = next((record["reasons"].pop(part) for part in MAIN if part in record["reasons"]), None)
    result = Result(
        cell=job.cell,
        status="done" if failed is None else "failed",
        reason=failed,
        checkpoint=None if job.model is None else job.model.checkpoint,
        asset=None if job.model is None else job.model.asset,
        source=None if job.model is None else job.model.source,
        bake=None if job.model is None else job.model.bake,
        trained=job.trained,
        **record,
    )
    write_result(job.folder, result)
    return result


def _read_old(job: Job) -> Result | None:
    """Return the earlier record of the benchmark cell, or None if it is missing or invalid."""
    try:
        return Results(job.root).read(job.cell)
    except MsbError:
        return None


def _keep_valid_parts(job: Job, old: Result | None) -> dict[str, Any]:
    """Return the valid parts of the earlier record. The result contains arguments of `Result`."""
    kept: dict[str, Any] = {"inputs": {}, "reasons": {}, "seconds": 0.0}
    if old is None:
        return kept
    for part in MEASURES:
        if part in job.parts:
            continue
        if part in old.inputs and _is_valid(part, job, old):
            kept["inputs"][part] = dict(old.inputs[part])
            keys = _KEYS.get(part, (part,))
            kept |= {key: getattr(old, key) for key in keys if getattr(old, key) is not None}
            kept["seconds"] = old.seconds
        elif part in old.reasons and _has_same_asset(job, old):
            kept["reasons"][part] = old.reasons[part]
    if old.status == "failed" and not any(part in MAIN for part in job.parts) and old.reason:
        kept["reasons"]["quality"] = old.reason
    return kept


def _is_valid(part: PartName, job: Job, old: Result) -> bool:
    """Return whether a recorded part was computed from the current inputs of the benchmark cell."""
    recorded, requested = old.inputs[part], job.requested.get(part)
    if requested is not None:
        return recorded == requested
    # If the protocol no longer requests the part, its current inputs are unknown. A part is also valid if it
    # has the same inputs as the images or the audit, and if these inputs are unchanged. The timing and the
    # walk (a camera path) also require unchanged rendering options.
    present = {name: value for main in MAIN for name, value in job.requested.get(main, {}).items()}
    images = job.requested.get("quality", {}).keys()
    same_options = (
        part not in ("timing", "walk") or recorded.keys() - _NOT_RENDERING == images - _NOT_RENDERING
    )
    same_values = all(present.get(name, value) == value for name, value in recorded.items())
    return same_options and same_values and _has_same_asset(job, old)


def _has_same_asset(job: Job, old: Result) -> bool:
    assets = old.asset, None if job.model is None else job.model.asset
    before, now = (None if asset is None else asset.sha256 for asset in assets)
    return before == now


def write_result(folder: Path, result: Result) -> None:
    """Write the record of a benchmark cell atomically."""
    with new_file(folder / RESULT) as file:
        file.write(result.to_json())


def make_reason(error: Exception) -> Reason:
    """Return the code and the message of an error as a `Reason`.

    The message of an unexpected error (INTERNAL) names its source line.
    """
    if isinstance(error, MsbError):
        return Reason(code=error.code, message=shorten(str(error).removeprefix(f"{error.code}: "), 500))
    frames = traceback.extract_tb(error.__traceback__)
    where = f" in {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return Reason(code=INTERNAL, message=shorten(f"{type(error).__name__}{where}: {error}", 500))
