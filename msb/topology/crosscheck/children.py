"""Ask each peer in a child process of its own, two at a time; a crash or a hang costs that peer alone."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import (
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
from msb.topology.crosscheck.peers import PEERS

if TYPE_CHECKING:
    from msb.topology.crosscheck.peers import Answers, Peer
    from msb.topology.crosscheck.repairs import PeerStep

AT_ONCE = 2
"""Child processes that run at once: each peer uses one core and a multiple of the mesh's memory."""
_POLL = 0.02


@dataclass(frozen=True)
class Reply:
    """A peer's reply: its version and its answers."""

    version: str
    answers: Answers


def ask_peers(
    names: Sequence[str], vertices: NDArray[Any], faces: NDArray[Any], timeout: float
) -> dict[str, Reply | str]:
    """Return each peer's reply about a mesh, or a sentence that says why there is none.

    Parameters
    ----------
    names : sequence of str
        Names in `PEERS`.
    vertices : (V, 3) floating
    faces : (F, 3) integers
        The faces: at least one row, and no index out of range.
    timeout : float
        Seconds each peer is given.
    """
    with shared_folder("msb-crosscheck-") as folder:
        leave_mesh(folder, vertices, faces)
        return run_children(names, folder, timeout)


def leave_mesh(folder: Path, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    """Put a mesh where the children look for it."""
    write_npy(folder / "vertices.npy", np.ascontiguousarray(vertices, np.float64))
    write_npy(folder / "faces.npy", np.ascontiguousarray(faces, np.int64))


def run_children(names: Sequence[str], folder: Path, timeout: float) -> dict[str, Reply | str]:
    """Return what each peer leaves in `folder`, where its mesh lies, or why it left nothing."""
    replies: dict[str, Reply | str] = {}
    running: dict[str, tuple[subprocess.Popen[bytes], float]] = {}
    waiting = list(names)
    try:
        while waiting or running:
            while waiting and len(running) < AT_ONCE:
                peer = waiting.pop(0)
                running[peer] = (_start(peer, folder), time.monotonic() + timeout)
            for peer, (child, deadline) in list(running.items()):
                if child.poll() is not None:
                    check_written(child.returncode)
                    replies[peer] = _reply(peer, folder, child.returncode)
                elif time.monotonic() > deadline:
                    replies[peer] = f"it did not answer within {timeout:g} s"
                else:
                    continue
                end(running.pop(peer)[0])
            time.sleep(_POLL)
    finally:
        for child, _ in running.values():
            end(child)
    return replies


def command(peer: str, folder: Path) -> list[str]:
    """Return the command line of the child that asks `peer` about the mesh in `folder`."""
    return module_command("msb.topology.crosscheck", peer, str(folder))


def _start(peer: str, folder: Path) -> subprocess.Popen[bytes]:
    with (folder / f"{peer}.err").open("wb") as errors:
        return subprocess.Popen(
            command(peer, folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # PyMeshLab prints
            stderr=errors,
            env=environment(),
        )


def _reply(peer: str, folder: Path, status: int) -> Reply | str:
    if status < 0:
        return f"it crashed ({ending(status)})"
    try:
        data = json.loads((folder / f"{peer}.json").read_text("utf-8"))
        return Reply(data["version"], data["answers"])
    except (OSError, ValueError, KeyError, TypeError):
        last = last_line((folder / f"{peer}.err").read_text("utf-8", "replace"))
        return f"it ended with {ending(status)}" + (f": {last}" if last else "")


def serve(peer: str, folder: Path) -> None:
    """Ask `peer` about the mesh in `folder` and leave its answers there: what a child process does.

    A peer that is asked to repair (`repairs.py`) also leaves a mesh.
    """
    from importlib.metadata import version

    from msb.topology.crosscheck.repairs import PEER_STEPS, work_in

    vertices = np.load(folder / "vertices.npy", allow_pickle=False)
    faces = np.load(folder / "faces.npy", allow_pickle=False)
    chosen: Peer | PeerStep
    if peer in PEER_STEPS:
        chosen, answers = PEER_STEPS[peer], work_in(folder, peer, vertices, faces)
    else:
        chosen = PEERS[peer]
        answers = chosen.ask(vertices, faces)
    reply = {"version": version(chosen.distribution), "answers": answers}
    partial = folder / f"{peer}.partial"
    with leaving():
        partial.write_text(json.dumps(reply, allow_nan=False), "utf-8")
        partial.rename(folder / f"{peer}.json")
