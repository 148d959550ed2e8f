"""Feed hostile bytes to readers in a guarded process. test_targets.py starts this process.

``python -m tests.fuzz.guarded_driver SCRATCH TARGET...`` feeds seeds and their mutations to targets. With
``corpora`` in place of targets it reads the files that `tests.fuzz.corpora` wrote to the folder SCRATCH.
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
"""Number of mutations per target. A fuzzer tries many more."""
SECONDS = 1.5
"""Limit for one input of a target, in seconds of processor time."""
ALL_SECONDS = 300 * TIMES
"""Limit for the process, in seconds of processor time. Unlike wall time, it does not depend on other work of
the machine."""
MOST_MIB = 350
"""Limit of resident memory while all corpora are read, in MiB.

A checkpoint of 330,000 tensors with 32 axes needs the most memory.
"""


def spin(until: float) -> None:
    """Use processor time until the clock of the process reaches `until`, in seconds."""
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
"""Actions that targets may perform, but readers of the corpora may not."""


def inputs(name: str, seeds: list[bytes]) -> list[bytes]:
    """Return the seeds and their mutations. They are the same in every run."""
    rng = random.Random(f"mutations of {name}")
    mutants = []
    for number in range(MUTATIONS):
        seed = rng.choice(seeds)
        mutate = mutate_text if number % 2 and seed[:1] in b"{[" and seed else mutate_bytes
        mutants.append(mutate(seed, rng) if len(seed) > 1 else seed)
    return [*seeds, *mutants]


def report(text: str) -> None:
    os.write(2, text.encode())


def feed_targets(scratch: Path, names: list[str]) -> None:
    """Feed the targets. The first failure ends the process."""
    feeds = {}
    for name in names:
        if name in EVIL:
            feeds[name] = Target(EVIL[name], list, "x").at(scratch), [b"x"]
            continue
        from fuzz.targets import TARGETS

        seeds = TARGETS[name].small_seeds()
        feeds[name] = TARGETS[name].at(scratch / name), inputs(name, seeds)
        for seed in seeds[:3]:  # Import lazily loaded modules now, because the guard forbids imports later.
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
    """Read every file of the index. The first file with an unexpected error code ends the process."""
    rows = json.loads((root / "index.json").read_text())
    for reader, path, _, code in rows:
        if not code:  # Import lazily loaded modules now, because the guard forbids imports later.
            getattr(readers, reader)(Path(path))
    limit_memory()
    guard = ClosedGuard(root, report)
    # This file is opened now, because the guard forbids it later.
    with Path("/proc/self/status").open(encoding="ascii") as status:
        for reader, path, guard.inside, expected in rows:
            read = EVIL_IF_CLOSED.get(reader) or getattr(readers, reader)
            code = ""
            with guard:
                try:
                    read(Path(path))
                except MsbError as error:
                    code = error.code
            if code != expected:
                sys.exit(f"{path} gives {code!r}, not {expected!r}")
        peak = peak_mib(status)
    if peak > MOST_MIB:
        sys.exit(f"peak memory {peak} MiB exceeds {MOST_MIB} MiB")
    print(f"{len(rows)} files")


def main(scratch: Path, names: list[str]) -> None:
    """Run the command line with a limit of `ALL_SECONDS`."""
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_CPU, (ALL_SECONDS, ALL_SECONDS))
    if names == ["corpora"]:
        read_corpora(scratch)
    else:
        feed_targets(scratch, names)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
