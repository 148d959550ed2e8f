"""Feed readers hostile bytes in a process that may do no harm: run by test_targets.py.

``python -m tests.fuzz.guarded_driver SCRATCH TARGET...`` feeds targets their seeds and mutations of them;
with ``corpora`` in place of targets it reads what `tests.fuzz.corpora` wrote to the folder SCRATCH.
"""

import json
import os
import random
import resource
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from fuzz import readers
from fuzz.guard import ClosedGuard, Guard, limit_memory, peak_mib
from fuzz.target import Target
from msb.errors import MsbError
from tests.fuzz.mutations import TIMES, mutate_bytes, mutate_text

MUTATIONS = 60 * TIMES
"""Of each target; fuzzing is for more."""
SECONDS = 1.5
"""Of processor time for one input of a target."""
ALL_SECONDS = 300 * TIMES
"""Of processor time for the process: other work on the machine does not count."""
MOST_MIB = 350
"""Peak of resident memory over the corpora; the highest is a third of a million tensors of 32 axes."""


def spin(until: float) -> None:
    """Be busy."""
    while time.process_time() <= until:
        pass


EVIL: dict[str, Callable[[Path], object]] = {
    "exec": lambda path: exec(compile("1", "<input>", "exec")),
    "write": lambda path: (Path.cwd() / "fuzz-was-here").open("x"),
    "child": lambda path: subprocess.run(["true"], check=True),
    "socket": lambda path: socket.create_connection(("127.0.0.1", 9)),
    "memory": lambda path: bytes(3 << 30),
    "slow": lambda path: spin(time.process_time() + SECONDS),
    "error": lambda path: {}["key"],
}
EVIL_IF_CLOSED: dict[str, Callable[[Path], object]] = {
    "import": lambda path: __import__("this"),
    "read": lambda path: (path.parent / "beside").read_bytes(),
    "compile": lambda path: compile("1", "<input>", "exec"),
}
"""What a target may do, but no reader of the corpora."""


def inputs(name: str, seeds: list[bytes]) -> list[bytes]:
    """Return the seeds and mutations of them, the same every time."""
    rng = random.Random(f"mutations of {name}")
    made = []
    for number in range(MUTATIONS):
        seed = rng.choice(seeds)
        mutate = mutate_text if number % 2 and seed[:1] in b"{[" and seed else mutate_bytes
        made.append(mutate(seed, rng) if len(seed) > 1 else seed)
    return [*seeds, *made]


def report(text: str) -> None:
    os.write(2, text.encode())


def feed_targets(scratch: Path, names: list[str]) -> None:
    """Feed all targets of these names; the first that fails ends the process."""
    feeds = {}
    for name in names:
        if name in EVIL:
            feeds[name] = Target(EVIL[name], list, "x").at(scratch), [b"x"]
            continue
        from fuzz.targets import TARGETS

        seeds = TARGETS[name].small_seeds()
        feeds[name] = TARGETS[name].at(scratch / name), inputs(name, seeds)
        for seed in seeds[:3]:  # what is imported on first use is imported now
            feeds[name][0](seed)
    limit_memory()
    guard = Guard(scratch, report)
    count = 0
    for name, (feed, contents) in feeds.items():
        for content in contents:
            start = time.process_time()
            try:
                with guard:
                    feed(content)
            except Exception:
                sys.stderr.write(f"{name}: {content!r:.2000}\n")
                raise
            if (spent := time.process_time() - start) > SECONDS:
                sys.exit(f"{name}: {spent:.1f} s of processor time: {content!r:.2000}")
            count += 1
    print(f"{len(feeds)} targets, {count} inputs")


def read_corpora(root: Path) -> None:
    """Read every file of the index; one that does not give its code ends the process."""
    rows = json.loads((root / "index.json").read_text())
    for reader, path, _, code in rows:
        if not code:  # what is imported on first use is imported now
            getattr(readers, reader)(Path(path))
    limit_memory()
    guard = ClosedGuard(root, report)
    # Opened now, read later: no such file may be opened under guard.
    with Path("/proc/self/status").open(encoding="ascii") as status:
        for reader, path, guard.inside, wanted in rows:
            read = EVIL_IF_CLOSED.get(reader) or getattr(readers, reader)
            code = ""
            with guard:
                try:
                    read(Path(path))
                except MsbError as error:
                    code = error.code
            if code != wanted:
                sys.exit(f"{path} gives {code!r}, not {wanted!r}")
        peak = peak_mib(status)
    if peak > MOST_MIB:
        sys.exit(f"{peak} MiB at most")
    print(f"{len(rows)} files")


def main(scratch: Path, names: list[str]) -> None:
    """Do what the command line says within `ALL_SECONDS`."""
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_CPU, (ALL_SECONDS, ALL_SECONDS))
    if names == ["corpora"]:
        read_corpora(scratch)
    else:
        feed_targets(scratch, names)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
