"""Kill a command at random moments, and see that nothing is half there and that it works again.

    python -m tests.robustness.kill export --times 100

The moments are drawn from a seed: a third over the whole duration of the command, which is measured first;
a third from the moment its first temporary file appears; a third in its last tenth, where files are renamed.
In half of the rounds the command replaces finished output (--force).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from data_stubs.make import write_checkpoint
from msb.adapters.exporter import export
from msb.asset import write_asset
from msb.base.atomic import is_leftover
from msb.bench.records import read_result
from msb.bench.run import run_protocol
from msb.render.machine import OF_THE_MOMENT
from tests.bench.protocols import protocol
from tests.conftest import ROOT

KINDS = ("anywhere", "writing", "ending")
WRITING = 0.04
"""How much of its time a command takes to write a file, about."""
USAGE_STATUS = 2
"""What a command ends with where output exists and there is no --force."""
NO_OUTPUT = {".lock", ".run.json"}
"""What a run keeps for itself while it lasts (msb/bench/folder.py)."""
TIMES = {
    "seconds",
    "timing",
    "floor",
    "timings_ms",
    "stages_ms",
    "stamps",
    "stamp",
    "run",
    "sentence",
    *OF_THE_MOMENT,
}
"""Keys of JSON that differ from run to run."""


@dataclass(frozen=True)
class Command:
    """One command to be killed.

    `prepare` makes inputs in a folder, their mesh so large; `line` is given that folder and the one of
    outputs. With `force` the command refuses to replace what is there without --force.
    """

    line: Callable[[Path, Path], Sequence[object]]
    prepare: Callable[[Path, int], object]
    force: bool = True


def _asset(folder: Path, size: int) -> None:
    write_checkpoint(folder / "checkpoint", size)
    write_asset(export(folder / "checkpoint"), folder / "mesh.triasset")


def _protocol(folder: Path, _size: int) -> None:
    bake = '[[bakes]]\nlabel = "kept"\ngeometry = "kept"'
    made = protocol(folder, ("two_dts",), head="[videos]\nframes = 4", tail=bake)
    (folder / "protocol.toml").write_bytes(made.text)


def _results(folder: Path, _size: int) -> None:
    assert run_protocol(protocol(folder, ("two_dts",))).exit_status == 0


def _exporting(*options: str) -> Command:
    def prepare(folder: Path, size: int) -> None:
        write_checkpoint(folder / "mesh", size)

    return Command(lambda at, out: ["export", *options, at / "mesh", out / "a.triasset"], prepare)


_TURN = ("render", "--turntable", 6, "--size", "320x240", ROOT / "data_stubs" / "checkpoint")
_RENDER = Command(lambda _at, out: [*_TURN, "-o", out / "images"], lambda *_: None)
COMMANDS = {
    "export": _exporting(),
    "export-folder": _exporting("--form", "folder"),
    "convert": Command(lambda at, out: ["convert", at / "mesh.triasset", out / "a.glb"], _asset),
    "render": _RENDER,
    "run": Command(lambda at, out: ["run", "-o", out / "results", at / "protocol.toml"], _protocol, False),
    "report": Command(lambda at, out: ["report", at / "results", "-o", out / "report"], _results),
    "compile": _RENDER,
}
"""`compile` renders on an empty cache of kernels: what a killed compiler leaves there must not matter."""


def finals(folder: Path) -> Iterator[Path]:
    """Yield every file below `folder` that stands under its final name."""
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and path.name not in NO_OUTPUT and not any(map(is_leftover, parts)):
            yield path


def leftovers(folder: Path) -> list[Path]:
    """Return what writers that were killed left, by the names `msb.base.atomic` gives.

    A writer may be at work: what vanishes meanwhile is passed over, which `Path.rglob` does not do.
    """
    found = ((root, name) for root, folders, files in os.walk(folder) for name in (*folders, *files))
    return [Path(root, name) for root, name in found if is_leftover(name)]


def content(path: Path, folder: Path) -> Any:
    """Return what a file holds, to compare two runs: without times, and without where `folder` is."""
    if path.suffix == ".mp4":
        import av

        # Not the bytes: its encoder, which has several threads, once found other bytes for equal frames.
        with av.open(str(path)) as film:
            return [frame.to_ndarray(format="rgb24").tobytes() for frame in film.decode(video=0)]
    data = path.read_bytes().replace(str(folder).encode(), b"FOLDER")
    return _timeless(json.loads(data)) if path.suffix == ".json" else data


def _timeless(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _timeless(value) for key, value in data.items() if key not in TIMES}
    return [_timeless(value) for value in data] if isinstance(data, list) else data


class Killer:
    """A command of `COMMANDS`, its inputs, and what it makes when left alone.

    `folder` takes inputs and outputs. A `size` of 160 gives a mesh of 680 thousand faces.
    """

    def __init__(self, name: str, folder: Path, size: int, seed: int) -> None:
        self.name, self.command, self.folder = name, COMMANDS[name], folder
        self.random = random.Random(seed)
        self.inputs = folder / "inputs"
        self.inputs.mkdir()
        self.command.prepare(self.inputs, size)
        self.alone = folder / "left_alone"
        (self.alone / "out").mkdir(parents=True)
        began = time.perf_counter()
        status, said = self.run(self.alone)
        self.seconds = time.perf_counter() - began
        assert status == 0, said
        self.wanted = self.contents(self.alone / "out")
        assert self.wanted, "the command writes nothing"

    @staticmethod
    def contents(out: Path) -> dict[str, Any]:
        """Return what stands under its final name."""
        return {path.relative_to(out).as_posix(): content(path, out) for path in finals(out)}

    def start(self, place: Path, *, force: bool = False) -> subprocess.Popen[bytes]:
        """Start the command in a process group of its own; its outputs go to a folder "out" of `place`."""
        line = map(str, self.command.line(self.inputs, place / "out"))
        cache = {"POCL_CACHE_DIR": str(place / "cache")} if self.name == "compile" else {}
        return subprocess.Popen(
            [sys.executable, "-m", "msb", *line, *(["--force"] if force else [])],
            env={**os.environ, "PYTHONPATH": str(ROOT), **cache},
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    def run(self, place: Path, *, force: bool = False) -> tuple[int, str]:
        """Let the command run to its end; return its status and what it said."""
        with self.start(place, force=force) as process:
            said = process.stderr.read().decode()
        return process.returncode, said

    def times(self, count: int) -> Counter[str]:
        """Kill the command `count` times and check after each; return how often what was there."""
        tally: Counter[str] = Counter()
        for number in range(count):
            kind = KINDS[number % len(KINDS)]
            part = (number // len(KINDS) + self.random.random()) / max(1, -(-count // len(KINDS)))
            tally += self.once(kind, part, replacing=self.command.force and self.random.random() < 0.5)
        return tally

    def once(self, kind: str, part: float, *, replacing: bool) -> Counter[str]:
        """Kill it once, `part` (0 to 1) of the way through the time that `kind` stands for, and check."""
        place = self.folder / "round"
        out = place / "out"
        shutil.rmtree(place, ignore_errors=True)
        if replacing:
            shutil.copytree(self.alone / "out", out)
        out.mkdir(parents=True, exist_ok=True)
        began = time.perf_counter()
        with self.start(place, force=replacing) as process:
            try:
                if kind == "writing":
                    while process.poll() is None and not leftovers(out):
                        time.sleep(0.001)
                    until = time.perf_counter() + WRITING * part * self.seconds
                else:
                    until = began + self.seconds * (part if kind == "anywhere" else 0.9 + 0.15 * part)
                while process.poll() is None and time.perf_counter() < until:
                    time.sleep(0.0005)
            finally:  # whatever went wrong here, nothing goes on behind it
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
        if process.returncode != -signal.SIGKILL:
            tally = Counter(ended=1)
        else:
            there = set(self.contents(out))
            complete = there == set(self.wanted)
            tally = Counter(killed=1, left=bool(leftovers(out)), output=bool(there), complete=complete)
        self.check(place, replacing=replacing)
        return tally

    def check(self, place: Path, *, replacing: bool) -> None:
        """See that what is there is whole, and that the command works again and gives what it should."""
        out = place / "out"
        there = self.contents(out)
        for name, data in there.items():
            if self.name == "run" and name.endswith("result.json"):
                read_result(out / name)  # it grows while a run goes on
            else:
                assert data == self.wanted.get(name), f"{name} is not as it should be"
        status, said = self.run(place, force=replacing)
        if self.command.force and there and not replacing:
            assert status == USAGE_STATUS, said
            assert said.startswith("OUTPUT_EXISTS: "), said
            status, said = self.run(place, force=True)
        assert status == 0, said
        assert self.contents(out) == self.wanted
        if self.name == "run":
            assert not leftovers(out), "a run clears what killed runs left"


def main() -> None:
    """Kill the commands named, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("commands", nargs="+", choices=[*COMMANDS, "all"], metavar="COMMAND")
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--size", type=int, default=160, help="lattice of the mesh; 160: 680 thousand faces")
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()
    for name in list(COMMANDS) if "all" in wanted.commands else wanted.commands:
        with tempfile.TemporaryDirectory(prefix="msb-kill-") as folder:
            killer = Killer(name, Path(folder), wanted.size, wanted.seed)
            tally = killer.times(wanted.times)
        print(
            f"{name}: {killer.seconds:.1f} s alone; {tally['killed']} killed, {tally['ended']} ended first; "
            f"temporary files after {tally['left']}, final ones after {tally['output']}, "
            f"all of them after {tally['complete']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
