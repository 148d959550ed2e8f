"""Feed targets their seeds and mutations of them, guarded as `fuzz.worker` is: run by test_targets.py."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from fuzz.guard import Guard, limit_memory
from fuzz.target import Target

if TYPE_CHECKING:
    from collections.abc import Callable

TIMES = int(os.environ.get("MSB_MUTATIONS", "1"))
MUTATIONS = 60 * TIMES
"""Of each target; fuzzing is for more."""
SECONDS = 1.5
"""Of processor time for one input."""


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


def inputs(name: str, seeds: list[bytes]) -> list[bytes]:
    """Return the seeds and mutations of them, the same every time."""
    from tests.asset.test_mutations import mutate_bytes, mutate_text

    rng = random.Random(f"mutations of {name}")
    made = []
    for number in range(MUTATIONS):
        seed = rng.choice(seeds)
        mutate = mutate_text if number % 2 and seed[:1] in b"{[" and seed else mutate_bytes
        made.append(mutate(seed, rng) if len(seed) > 1 else seed)
    return [*seeds, *made]


def main(scratch: Path, names: list[str]) -> None:
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
    warnings.simplefilter("error")
    limit_memory()
    guard = Guard(scratch, lambda text: os.write(2, text.encode()) and None)
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


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
