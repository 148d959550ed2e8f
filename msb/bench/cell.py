"""Compute one cell: its parts, each of which may fail without the others, and its record, written whole."""

import contextlib
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msb.base.atomic import new_file
from msb.bench.folder import RESULT, Results, check_run
from msb.bench.job import MAIN, Done, Job, Part
from msb.bench.parts import (
    measure_audit,
    measure_chamfer,
    measure_repairs,
    measure_timing,
    measure_trial,
    read_own_timing,
    read_training,
)
from msb.bench.quality import measure_quality
from msb.bench.records import Reason, Result
from msb.bench.walk import measure_walk
from msb.errors import MsbError, shorten

# The code of a failure that is a bug of ours.
INTERNAL = "INTERNAL"
# Part -> the function that computes it, which returns keys of `Result` and their values.
MEASURES: dict[Part, Callable[[Job], dict[str, Any]]] = {
    "quality": measure_quality,
    "audit": measure_audit,
    "trial": measure_trial,
    "repairs": measure_repairs,
    "walk": measure_walk,
    "chamfer": measure_chamfer,
    "training": read_training,
    "renderer_timing": read_own_timing,
    "timing": measure_timing,
}
# The keys of `Result` that a part fills, where they are others than its name.
_KEYS: dict[Part, tuple[str, ...]] = {
    "quality": ("quality", "setup", "renders", "renderer", "device"),
    "timing": ("timing", "memory", "floor", "device"),
}
# The inputs of parts with images that say nothing of how these are drawn.
_NO_OPTIONS = frozenset(
    ("cameras", "photographs", "metrics", "device", "clock", "flight", "definition", "film")
)


def compute(job: Job) -> Done:
    """Compute the job's parts and write the cell's record; other recorded parts stay if still valid."""
    check_run(job.root, job.run)
    start = time.perf_counter()
    record = _kept(job, _old(job))
    if any(part in MAIN for part in job.parts):
        # From here to the new record there is none: images and numbers of two runs must not stand together.
        with contextlib.suppress(FileNotFoundError):
            (job.folder / RESULT).unlink()
    for part, inputs in job.parts.items():
        try:
            filled = MEASURES[part](job)
            if part == "quality" and "timing" in record["inputs"]:
                del filled["device"]  # the one on record is that of the timing, where it matters
            record |= filled
            record["inputs"][part] = dict(inputs)
        except Exception as error:  # even a bug of ours costs no more than one part of one cell
            if isinstance(error, MsbError) and error.code == "RUN_SCHEDULER":
                raise
            record["reasons"][part] = reason_of(error)
    record["seconds"] += time.perf_counter() - start
    result = _write(job, record)
    return Done(job.cell, result.status, time.perf_counter() - start)


def write_lost(job: Job, reason: Reason) -> None:
    """Write the record of a job whose process died before it could do so."""
    old = _old(job)
    if old is None or any(part in MAIN for part in job.parts):
        write_result(job.folder, Result(cell=job.cell, status="failed", reason=reason, seconds=0.0))
        return
    record = _kept(job, old)
    record["reasons"] |= dict.fromkeys(job.parts, reason)
    _write(job, record)


def _write(job: Job, record: dict[str, Any]) -> Result:
    """Write the record of a job's cell, with the parts that it has by now, and return it."""
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


def _old(job: Job) -> Result | None:
    """Return the record that there is of a job's cell, None where there is none that can be read."""
    try:
        return Results(job.root).read(job.cell)
    except MsbError:
        return None


def _kept(job: Job, old: Result | None) -> dict[str, Any]:
    """Return what of the record there is outlives this job, as arguments of `Result`."""
    kept: dict[str, Any] = {"inputs": {}, "reasons": {}, "seconds": 0.0}
    if old is None:
        return kept
    for part in MEASURES:
        if part in job.parts:
            continue
        if part in old.inputs and _holds(part, job, old):
            kept["inputs"][part] = dict(old.inputs[part])
            keys = _KEYS.get(part, (part,))
            kept |= {key: getattr(old, key) for key in keys if getattr(old, key) is not None}
            kept["seconds"] = old.seconds
        elif part in old.reasons and _same_asset(job, old):
            kept["reasons"][part] = old.reasons[part]
    if old.status == "failed" and not any(part in MAIN for part in job.parts) and old.reason:
        kept["reasons"]["quality"] = old.reason
    return kept


def _holds(part: Part, job: Job, old: Result) -> bool:
    """Return whether a part on record is of the cell as it is now: a new model must not have old numbers."""
    held, wanted = old.inputs[part], job.wanted.get(part)
    if wanted is not None:
        return held == wanted
    # Nobody asks for it any more, so of its inputs only those are known that the images or the audit share.
    known = {name: value for main in MAIN for name, value in job.wanted.get(main, {}).items()}
    # An option that there was, or is now, and not both, is no input that they share.
    images = job.wanted.get("quality", {}).keys()
    alike = part not in ("timing", "walk") or held.keys() - _NO_OPTIONS == images - _NO_OPTIONS
    same = all(known.get(name, value) == value for name, value in held.items())
    return alike and same and _same_asset(job, old)


def _same_asset(job: Job, old: Result) -> bool:
    assets = old.asset, None if job.model is None else job.model.asset
    before, now = (None if asset is None else asset.sha256 for asset in assets)
    return before == now


def write_result(folder: Path, result: Result) -> None:
    """Write a cell's record, whole or not at all."""
    with new_file(folder / RESULT) as file:
        file.write(result.to_json())


def reason_of(error: Exception) -> Reason:
    """Return an error as a record holds it; an error that is not ours is a bug, and its place is recorded."""
    if isinstance(error, MsbError):
        return Reason(code=error.code, message=shorten(str(error).removeprefix(f"{error.code}: "), 500))
    frames = traceback.extract_tb(error.__traceback__)
    where = f" in {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return Reason(code=INTERNAL, message=shorten(f"{type(error).__name__}{where}: {error}", 500))
