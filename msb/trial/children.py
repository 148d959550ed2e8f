"""Run attempts in child processes; one that hangs, crashes or takes too much costs itself alone."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import (
    apart,
    check_written,
    end,
    ending,
    environment,
    last_line,
    leaving,
    module_command,
    shared_folder,
)
from msb.base.npz import write_npy
from msb.errors import shorten
from msb.trial.limits import end_with_parent, limit_memory
from msb.trial.mesh import load_mesh
from msb.trial.registry import TASKS
from msb.trial.task import Made, Reply
from msb.trial.units import Unit

if TYPE_CHECKING:
    from msb.trial.limits import Limits
    from msb.trial.mesh import TriedMesh
    from msb.trial.task import Attempt, Task

_POLL = 0.02
_OF_MEMORY = re.compile(r"MemoryError|bad_alloc|[Oo]ut of memory|[Cc]annot allocate|Unable to allocate")
_REPLY = "reply.json"


def run_attempt(
    task: Task, attempt: Attempt, mesh: TriedMesh, arrays: Mapping[str, NDArray[Any]], limits: Limits
) -> Reply:
    """Return what became of an attempt at a task.

    Parameters
    ----------
    task, attempt : Task, Attempt
    mesh : TriedMesh
    arrays : mapping of str to ndarray
        What `Task.prepare` made.
    limits : Limits

    Notes
    -----
    All files are in a folder that is removed. The child is ended at its limit, and by whatever ends this
    call: an interrupt, an error, a signal that raises.
    """
    unit = None if attempt.any_unit else Unit.of(mesh)
    with shared_folder("msb-trial-") as folder:
        (mesh if unit is None else unit.enter(mesh)).save(folder)
        for key, array in (arrays if unit is None else unit.enter_points(arrays)).items():
            write_npy(folder / f"given.{key}.npy", array)
        words = (task.name, attempt.library, str(folder), str(limits.memory))
        start = time.monotonic()
        with (folder / "errors").open("wb") as errors:
            child = subprocess.Popen(
                command(*words),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # libraries print
                stderr=errors,
                env=environment(),
                cwd=folder,
                **apart(),  # Ctrl-C is ours to handle
            )
        try:
            while child.poll() is None:
                if time.monotonic() > start + limits.seconds:
                    text = f"it did not end within {limits.seconds:g} s (--seconds gives more)"
                    return Reply(None, text, "time", limits.seconds)
                time.sleep(_POLL)
        finally:
            end(child)
        check_written(child.returncode)
        reply = _reply(folder, child.returncode, limits)
    if reply.made is None or unit is None:
        return reply
    return replace(reply, made=unit.leave(reply.made, task.powers))


def command(task: str, library: str, folder: str, memory: str) -> list[str]:
    """Return the command line of the child."""
    return module_command("msb.trial", task, library, folder, memory)


def _reply(folder: Path, status: int, limits: Limits) -> Reply:
    said = (folder / "errors").read_text("utf-8", "replace")
    try:
        data = json.loads((folder / _REPLY).read_text("utf-8"))
        version, seconds = data["version"], data["seconds"]
        if data["why"] is None:
            return Reply(_made(folder, data), version=version, seconds=seconds)
        why = str(data["why"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        version = seconds = None
        why = last_line(said) or shorten(str(error), 200)
        if not _OF_MEMORY.search(said):
            return Reply(None, f"it crashed ({ending(status)})" if status else why, "crash")
    if _OF_MEMORY.search(why) or _OF_MEMORY.search(said):
        text = f"it needs more memory than {limits.memory:g} GiB"
        return Reply(None, text, "memory", seconds, version)
    return Reply(None, why, None, seconds, version)


def _made(folder: Path, data: dict[str, Any]) -> Made:
    arrays = {key: np.load(folder / f"{key}.npy", allow_pickle=False) for key in data["arrays"]}
    return Made(data["numbers"], {key: load_mesh(folder, key) for key in data["meshes"]}, arrays)


def serve(task: str, library: str, folder: Path, memory: float) -> None:
    """Do what a child process does: the attempt within the memory, and leave the reply in `folder`."""
    end_with_parent()
    chosen = TASKS[task]
    attempt = next(one for one in (*chosen.attempts, *chosen.instead) if one.library == library)
    mesh = load_mesh(folder)
    given = {
        path.name.split(".")[1]: np.load(path, allow_pickle=False) for path in folder.glob("given.*.npy")
    }
    limit_memory(memory)
    made, why = Made(), None
    start = time.perf_counter()
    try:
        made = attempt.work(mesh, chosen.parameters, given)
    except (Exception, MemoryError) as error:  # the library's words are the result
        why = shorten(f"{error}" or type(error).__name__, 200)
        if isinstance(error, MemoryError):
            why = f"MemoryError: {why}"
    seconds = time.perf_counter() - start
    from importlib.metadata import version

    reply = {
        "version": version(attempt.library),
        "seconds": seconds,
        "why": why,
        "numbers": made.numbers,
        "meshes": list(made.meshes),
        "arrays": list(made.arrays),
    }
    partial = folder / "reply.partial"
    with leaving():
        for name, one in made.meshes.items():
            one.save(folder, name)
        for name, array in made.arrays.items():
            write_npy(folder / f"{name}.npy", array)
        partial.write_text(json.dumps(reply, allow_nan=False), "utf-8")
        partial.rename(folder / _REPLY)
