"""Kill a command at random moments, and see that nothing is half there and that it works again.

    python -m tests.robustness.kill export --times 100

The moments are drawn from a seed: a third over the whole duration of the command, which is measured first;
a third from the moment its first temporary file appears; a third in its last tenth, where files are renamed.
In half of the rounds the command replaces finished output (--force).
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.robustness.commands import COMMANDS, Command
from tests.robustness.whole import check_whole, content, finals, leftovers

KINDS = ("anywhere", "writing", "ending")
WRITING = 0.04
"""How much of its time a command takes to write a file, about."""
USAGE_STATUS = 2
"""What a command ends with where output exists and there is no --force."""


@dataclass
class Tally:
    """What became of the kills.

    Attributes
    ----------
    kills : int
        Processes killed before they ended.
    ended : int
        Those that ended first.
    left : int
        Kills after which temporary files lay there.
    output : int
        Kills after which something stood under its final name.
    complete : int
        Of these, where all of it did.
    """

    kills: int = 0
    ended: int = 0
    left: int = 0
    output: int = 0
    complete: int = 0
    moments: list[tuple[str, float]] = field(default_factory=list)


class Killer:
    """One command, its inputs, and what it makes when left alone.

    Parameters
    ----------
    command : Command
    folder : Path
        For inputs and outputs; whoever made it removes it.
    size : int
        Lattice of the mesh that is exported or converted: 160 gives 680 thousand faces.
    seed : int
    """

    def __init__(self, command: Command, folder: Path, size: int, seed: int) -> None:
        self.command, self.folder = command, folder
        self.random = random.Random(seed)
        self.inputs = folder / "inputs"
        self.inputs.mkdir()
        command.prepare(self.inputs, size)
        place = folder / "left_alone"
        out = self.out(place)
        began = time.perf_counter()
        status, said = self.run(place)
        self.seconds = time.perf_counter() - began
        assert status == 0, said
        self.wanted = self.contents(out)
        assert self.wanted, "the command writes nothing"

    @staticmethod
    def out(place: Path) -> Path:
        """Return the folder for the outputs of one round; beside it lies what else the round needs."""
        (place / "out").mkdir(parents=True)
        return place / "out"

    @staticmethod
    def contents(out: Path) -> dict[str, Any]:
        """Return what stands under its final name, checked to be whole."""
        found = {}
        for path in finals(out):
            check_whole(path)
            found[path.relative_to(out).as_posix()] = content(path, out)
        return found

    def start(self, place: Path, *, force: bool = False) -> subprocess.Popen[bytes]:
        """Start the command in a process group of its own."""
        return subprocess.Popen(
            [sys.executable, *self.command.argv(self.inputs, place / "out", force=force)],
            env=self.command.environ(place),
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    def run(self, place: Path, *, force: bool = False) -> tuple[int, str]:
        """Let the command run to its end; return its status and what it said."""
        with self.start(place, force=force) as process:
            assert process.stderr is not None
            said = process.stderr.read().decode()
        return process.returncode, said

    def times(self, count: int) -> Tally:
        """Kill the command `count` times and check after each; raises where something is wrong."""
        tally = Tally()
        for number in range(count):
            kind = KINDS[number % len(KINDS)]
            part = (number // len(KINDS) + self.random.random()) / max(1, -(-count // len(KINDS)))
            replacing = self.command.force and self.random.random() < 0.5
            self.once(self.folder / "round", kind, part, tally, replacing=replacing)
        return tally

    def once(self, place: Path, kind: str, part: float, tally: Tally, *, replacing: bool) -> None:
        """Kill it once, `part` (0 to 1) of the way through the time that `kind` stands for."""
        shutil.rmtree(place, ignore_errors=True)
        out = self.out(place)
        if replacing:
            shutil.copytree(self.folder / "left_alone" / "out", out, dirs_exist_ok=True)
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
        killed = process.returncode == -signal.SIGKILL
        tally.kills += killed
        tally.ended += not killed
        tally.moments.append((kind, time.perf_counter() - began))
        self.check(place, tally, killed=killed, replacing=replacing)

    def check(self, place: Path, tally: Tally, *, killed: bool, replacing: bool) -> None:
        """See that what is there is whole, and that the command works again and gives what it should."""
        out = place / "out"
        there = self.contents(out)
        for name, data in there.items():
            assert self._same(name, data), f"{name} is not as it should be"
        if killed:
            tally.left += bool(leftovers(out))
            tally.output += bool(there)
            tally.complete += set(there) == set(self.wanted)
        status, said = self.run(place, force=replacing)
        if self.command.force and there and not replacing:
            assert status == USAGE_STATUS, said
            assert said.startswith("OUTPUT_EXISTS: "), said
            status, said = self.run(place, force=True)
        assert status == 0, said
        assert "Traceback" not in said
        again = self.contents(out)
        assert again.keys() == self.wanted.keys()
        for name, data in again.items():
            assert data == self.wanted[name], f"{name} differs from what the command makes when left alone"
        if not self.command.force:
            assert not leftovers(out), "a run clears what killed runs left"

    def _same(self, name: str, data: Any) -> bool:
        # A record grows while a run goes on: that it is whole is all that can be asked of it.
        grows = self.command.name == "run" and name.endswith("result.json")
        return grows or data == self.wanted.get(name)


def main() -> None:
    """Kill the commands named, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("commands", nargs="+", choices=[*COMMANDS, "all"], metavar="COMMAND")
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--size", type=int, default=160, help="lattice of the mesh; 160: 680 thousand faces")
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()
    names = list(COMMANDS) if "all" in wanted.commands else wanted.commands
    for name in names:
        with tempfile.TemporaryDirectory(prefix="msb-kill-") as folder:
            killer = Killer(COMMANDS[name], Path(folder), wanted.size, wanted.seed)
            tally = killer.times(wanted.times)
        print(
            f"{name}: {killer.seconds:.1f} s alone; {tally.kills} killed, {tally.ended} ended first; "
            f"temporary files after {tally.left}, final ones after {tally.output}, "
            f"all of them after {tally.complete}",
            flush=True,
        )


if __name__ == "__main__":
    main()
