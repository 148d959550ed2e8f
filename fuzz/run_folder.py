"""Targets for the files in which a run records finished work."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.target import Target
from msb.bench.folder import Results
from msb.bench.models import ModelTask, _record

if TYPE_CHECKING:
    from msb.bench.photographs import ViewState

PHOTOGRAPH = b"no image is read to know its hash"


def model_task(root: Path) -> ModelTask:
    """Return a task that prepares a model that does not exist."""
    return ModelTask(root, "run", "capture", "desk", "two_dts", Path("model.triasset"))


def read_model(path: Path) -> None:
    """Read the record of a model. If it is accepted, every file must be unchanged."""
    from msb.bench.digest import stamp
    from msb.bench.models import find_known_model

    known = find_known_model(Results(path.parents[3]), model_task(path.parents[3]))
    assert known is None or all(stamp(Path(name)) == (name, *rest) for name, *rest in known.stamps)


def models() -> list[bytes]:
    """Return records of models whose files exist, are missing, or have impossible names."""
    from msb.bench.digest import stamp
    from msb.bench.models import ModelAsset
    from msb.bench.records import File

    asset = File(path="model.triasset", bytes=9, sha256="0" * 64)
    key = json.dumps(["model.triasset", "two_dts"])
    known = ModelAsset(
        method="two_dts", checkpoint=None, asset=asset, background=(0, 0, 0), stamps=(), training={}, key=key
    )
    there, gone, nowhere = stamp(Path(__file__)), ("model.triasset", 9, 9), ("nul\0", 9, 9)
    cases = ((), (there, gone), (nowhere,))
    return [known.model_copy(update={"stamps": stamps}).to_json() for stamps in cases]


def views() -> ViewState:
    """Return the test views of a scene of one photograph."""
    from msb.bench.photographs import ViewState
    from msb.bench.records import Setup

    setup = Setup(camera_convention="gs_fov", image_folder="images", gt_resized=False, background=(0, 0, 0))
    return ViewState("cameras", "photographs", setup, ("a",))


def read_hashes(path: Path) -> None:
    """Compare photographs with the hashes of a run."""
    from msb.bench.photographs import _find_fault

    _find_fault(path.parent, views())


def hashes() -> list[bytes]:
    """Return the list of hashes of `views`."""
    from msb.bench.photographs import SCHEMA

    files = {"a.png": hashlib.sha256(PHOTOGRAPH).hexdigest()}
    return [json.dumps({"schema": SCHEMA, "photographs": "photographs", "files": files}).encode()]


def read_run(path: Path) -> None:
    """Read the lock of the folder, and whether it belongs to this run."""
    from msb.bench.folder import _holder, check_run

    _holder(path.parent)
    check_run(path.parent, "run")


def runs() -> list[bytes]:
    """Return the lock of this run, and the lock of another run."""
    about = {"host": "a", "process": 1, "since": "Mon Nov 23 12:00:00 2026"}
    return [json.dumps({"run": run, **about}).encode() for run in ("run", "another")]


def targets() -> dict[str, Target]:
    """Return the targets by name."""
    from msb.bench.folder import _RUN
    from msb.bench.photographs import HASHES

    known = _record(Results(Path()), model_task(Path())).as_posix()
    return {
        "run_model": Target(read_model, models, known),
        "run_photographs": Target(read_hashes, hashes, HASHES, beside={"a.png": PHOTOGRAPH}),
        "run": Target(read_run, runs, _RUN),
    }
