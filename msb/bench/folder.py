"""The results folder: its paths, and the lock that allows one run at a time to write there."""

import contextlib
import json
import os
import platform
import secrets
import time
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from msb.base.atomic import new_file, remove_leftovers
from msb.base.extras import need_extra
from msb.bench.records import Cell, Result, read_result
from msb.bench.validation import read_json
from msb.errors import InputError, MsbError, OutputError, UsageError

RESULT = "result.json"
# Folders beside a benchmark record that contain images of trials and repairs.
TRIAL_FOLDER, REPAIRS_FOLDER = "trial", "repairs"
# The video beside a benchmark record. The video shows the second of the camera path with the most flicker.
WALK_FILM = "walk.mp4"
_LOCK = ".lock"
# The file that names the current run, and the maximum size of this file in bytes.
_RUN = ".run.json"
_MAX_RUN = 1 << 16


@dataclass(frozen=True)
class Results:
    """Paths below the results folder `root`. docs/protocol.md shows the folders."""

    root: Path

    def cell(self, cell: Cell) -> Path:
        """Return the folder for the record and the images of one benchmark cell."""
        return self.root.joinpath("cells", *cell.names)

    def record(self, cell: Cell) -> Path:
        """Return the file of one benchmark cell's record."""
        return self.cell(cell) / RESULT

    def records(self) -> list[Path]:
        """Return the files of all records, sorted."""
        return sorted((self.root / "cells").glob(f"*/*/*/*/{RESULT}"))

    def read(self, cell: Cell) -> Result:
        """Return the record of one benchmark cell."""
        path = self.record(cell)
        result = read_result(path)
        self.check_place(result, path)
        return result

    def check_place(self, result: Result, path: Path) -> None:
        """Raise RECORD_INVALID if a record is in the folder of another benchmark cell."""
        place = self.record(result.cell)
        # File systems and archives may store a name in another Unicode form.
        if unicodedata.normalize("NFC", str(place)) != unicodedata.normalize("NFC", str(path)):
            text = (
                f"this record of {'/'.join(result.cell.names)} is in the folder of another cell; move it back"
            )
            raise InputError("RECORD_INVALID", text, file=path)

    def ground_truth(self, dataset: str, scene: str, key: str) -> Path:
        """Return the ground truth folder of a scene. Pass `ViewState.photographs` as `key`."""
        return self.root / "ground_truth" / dataset / scene / key

    def asset(self, dataset: str, scene: str, model: str) -> Path:
        """Return the path of an exported asset.

        `model` is the label of the model. A model without a label is named by its method.
        """
        return self.root / "assets" / dataset / scene / f"{model}.triasset"

    def bake(self, dataset: str, scene: str, model: str, label: str) -> Path:
        """Return the path of a bake.

        `model` is the label of the model. A model without a label is named by its method.
        """
        return self.root / "assets" / dataset / scene / model / f"{label}.triasset"

    def video(self, *names: str) -> Path:
        """Return the path of a video.

        `names` contains dataset, scene and model. Without a model, the video shows all models of the scene.
        """
        return self.root.joinpath("videos", *names[:-1], f"{names[-1]}.mp4")


@contextlib.contextmanager
def lock_results(root: Path) -> Iterator[str]:
    """Lock the results folder for one run, remove temporary files of killed runs, and yield the run's id.

    The operating system releases the lock when the process ends for any reason, so a lock is never stale.
    """
    need_extra("bench", "filelock", what="a folder of results")
    from filelock import FileLock, Timeout

    try:
        root.mkdir(parents=True, exist_ok=True)
        lock = FileLock(root / _LOCK, timeout=0)
        lock.acquire()
    except Timeout:
        text = f"another msb run is writing here{_holder(root)}; wait for it or stop it"
        raise UsageError("RESULTS_BUSY", text, file=root) from None
    except (OSError, NotImplementedError) as error:
        reason = f"the folder cannot be locked: {getattr(error, 'strerror', None) or error}"
        if isinstance(error, FileExistsError | NotADirectoryError):
            reason = "the path is a file, or is below a file; choose a folder for the results"
        raise OutputError("OUTPUT_UNWRITABLE", reason, file=root) from error
    try:
        remove_leftovers(root)
        run = secrets.token_hex(8)
        about = {"run": run, "host": platform.node(), "process": os.getpid(), "since": time.ctime()}
        with new_file(root / _RUN) as file:
            file.write(json.dumps(about).encode())
        yield run
    finally:
        remove_leftovers(root)  # remove temporary files of workers that died or were interrupted
        with contextlib.suppress(OSError):
            (root / _RUN).unlink()
        lock.release()


def check_names(*paths: Path | None) -> None:
    """Raise USAGE for a path that is not valid UTF-8, because records are JSON."""
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError:
            text = "the name is not valid UTF-8 and cannot be recorded; rename it or use another folder"
            raise UsageError("USAGE", text, file=path) from None


def check_run(root: Path, run: str) -> None:
    """Raise RUN_SCHEDULER if this machine cannot access the results folder of the run."""
    if _read_run(root).get("run") != run:
        text = (
            f"worker {platform.node()} cannot see the results of this run; all machines of a cluster need "
            "results, scenes and models under the same paths"
        )
        raise UsageError("RUN_SCHEDULER", text, file=root)


def _holder(root: Path) -> str:
    """Return process, host and time of the run that writes to a results folder, in brackets."""
    about = _read_run(root)
    if not about:
        return ""
    return f" (process {about.get('process')} on {about.get('host')} since {about.get('since')})"


def _read_run(root: Path) -> dict[str, object]:
    """Return the content of the file that names the current run.

    If no run is active, return an empty content.
    """
    try:
        about = read_json(root / _RUN, _MAX_RUN)
    except MsbError:
        return {}
    return about if isinstance(about, dict) else {}
