"""The results folder: where everything lies, and which run may write there."""

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
from msb.bench.checked import read_json
from msb.bench.records import Cell, Result, read_result
from msb.errors import InputError, MsbError, OutputError, UsageError

RESULT = "result.json"
# The folders beside a record with the pictures of its trials and of repairs.
TRIAL_FOLDER, REPAIRS_FOLDER = "trial", "repairs"
# The film beside a record of the worst second of its walk.
WALK_FILM = "walk.mp4"
_LOCK = ".lock"
_RUN = ".run.json"
_MAX_RUN = 1 << 16


@dataclass(frozen=True)
class Results:
    """Paths below the results folder `root`; docs/protocol.md shows the tree."""

    root: Path

    def cell(self, cell: Cell) -> Path:
        """Return the folder of one cell's record and images."""
        return self.root.joinpath("cells", *cell.names)

    def record(self, cell: Cell) -> Path:
        """Return the file of one cell's record."""
        return self.cell(cell) / RESULT

    def records(self) -> list[Path]:
        """Return the files of all records, sorted."""
        return sorted((self.root / "cells").glob(f"*/*/*/*/{RESULT}"))

    def read(self, cell: Cell) -> Result:
        """Return one cell's record."""
        path = self.record(cell)
        result = read_result(path)
        self.check_place(result, path)
        return result

    def check_place(self, result: Result, path: Path) -> None:
        """Refuse a record outside of its cell's place: its numbers would be taken for another cell's."""
        place = self.record(result.cell)
        # A file system, or an archive of it, may have another form of the same name.
        if unicodedata.normalize("NFC", str(place)) != unicodedata.normalize("NFC", str(path)):
            text = f"it is of {'/'.join(result.cell.names)}, and does not lie there"
            raise InputError("RECORD_INVALID", text, file=path)

    def ground_truth(self, dataset: str, scene: str, key: str) -> Path:
        """Return the folder of the photographs as they are compared."""
        return self.root / "ground_truth" / dataset / scene / key

    def asset(self, dataset: str, scene: str, model: str) -> Path:
        """Return the place of the asset made from a checkpoint; `model` is its label, else its method."""
        return self.root / "assets" / dataset / scene / f"{model}.triasset"

    def bake(self, dataset: str, scene: str, model: str, label: str) -> Path:
        """Return the place of a bake of a model; `model` is its label, else its method."""
        return self.root / "assets" / dataset / scene / model / f"{label}.triasset"

    def video(self, *names: str) -> Path:
        """Return the film of dataset, scene and model, or of all models of a scene below each other."""
        return self.root.joinpath("videos", *names[:-1], f"{names[-1]}.mp4")


@contextlib.contextmanager
def exclusive(root: Path) -> Iterator[str]:
    """Hold the results folder for one run, remove half-written files of killed runs, and yield the run's id.

    The operating system releases the lock when its holder dies, however it dies, so no lock can be stale.
    """
    need_extra("bench", "filelock", what="a folder of results")
    from filelock import FileLock, Timeout

    try:
        root.mkdir(parents=True, exist_ok=True)
        lock = FileLock(root / _LOCK, timeout=0)
        lock.acquire()
    except Timeout:
        text = f"another msb run writes here{_holder(root)}; wait for it or stop it"
        raise UsageError("RESULTS_BUSY", text, file=root) from None
    except (OSError, NotImplementedError) as error:
        reason = f"it cannot be locked: {getattr(error, 'strerror', None) or error}"
        if isinstance(error, FileExistsError | NotADirectoryError):
            reason = "it is a file, or lies in one; results need a folder"
        raise OutputError("OUTPUT_UNWRITABLE", reason, file=root) from error
    try:
        remove_leftovers(root)
        run = secrets.token_hex(8)
        about = {"run": run, "host": platform.node(), "process": os.getpid(), "since": time.ctime()}
        with new_file(root / _RUN) as file:
            file.write(json.dumps(about).encode())
        yield run
    finally:
        remove_leftovers(root)  # of workers that died, or were broken off by an interrupt
        with contextlib.suppress(OSError):
            (root / _RUN).unlink()
        lock.release()


def check_names(*paths: Path | None) -> None:
    """Refuse paths that no record could hold, because JSON is UTF-8."""
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError:
            text = "its name is not UTF-8, so no record could hold it; rename it or work in another folder"
            raise UsageError("USAGE", text, file=path) from None


def check_run(root: Path, run: str) -> None:
    """Refuse to work for a run whose results folder this machine does not see."""
    if _about(root).get("run") != run:
        text = (
            f"worker {platform.node()} does not see this run's results there; all machines of a cluster "
            "need results, scenes and models under the same paths"
        )
        raise UsageError("RUN_SCHEDULER", text, file=root)


def _holder(root: Path) -> str:
    about = _about(root)
    if not about:
        return ""
    return f" (process {about.get('process')} on {about.get('host')} since {about.get('since')})"


def _about(root: Path) -> dict[str, object]:
    try:
        about = read_json(root / _RUN, _MAX_RUN)
    except MsbError:
        return {}
    return about if isinstance(about, dict) else {}
