"""Read every bad asset below a folder in a process that tolerates nothing else: run by test_bad_assets.py.

At most 1 GiB of address space beyond what the interpreter and NumPy take; no import, exec, compile, child
process or socket; no file opened that is not in the corpus, and none for writing.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from msb.asset import load, validate
from msb.errors import MsbError

if TYPE_CHECKING:
    from collections.abc import Iterable

FORBIDDEN = (
    "import",
    "exec",
    "compile",
    "subprocess.",
    "socket.",
    "os.",
    "ctypes.",
    "shutil.",
    "pty.",
    "urllib.",
)
HARMLESS = ("os.scandir", "os.listdir")
LIMIT = 1 << 30
MOST_MIB = 300
"""Peak of resident memory over all cases."""


def guard(root: Path) -> None:
    """Make every forbidden deed of this process fatal from now on."""

    def hook(event: str, args: tuple[object, ...]) -> None:
        if event == "open":
            name, mode, flags = args
            path = os.path.normpath(root / os.fsdecode(name))  # type: ignore[arg-type]
            writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if not path.startswith(f"{root}{os.sep}") or writes:
                fail(f"opened {name!r} with mode {mode!r} and flags {flags!r}")
        elif event.startswith(FORBIDDEN) and event not in HARMLESS:
            fail(f"{event} {args!r}")

    sys.addaudithook(hook)


def fail(what: str) -> None:
    """End the process at once: an exception could be caught."""
    os.write(2, f"forbidden: {what}\n".encode())
    os._exit(1)


def peak_mib(status: Iterable[str]) -> int:
    """Return the peak of resident memory from /proc/self/status.

    Not from `getrusage`, whose peak a process inherits from the one that forked it: pytest may be large.
    """
    return next(int(line.split()[1]) >> 10 for line in status if line.startswith("VmHWM"))


def read(path: Path) -> set[str]:
    """Return the codes that `load` and `validate` give."""
    codes = set()
    try:
        codes |= {item.code for item in load(path).warnings}
    except MsbError as error:
        codes.add(error.code)
    try:
        codes |= {item.code for item in validate(path).findings}
    except MsbError as error:
        codes.add(error.code)
    return codes


def main(root: Path) -> None:
    """Read all cases of the index below `root` and print their number."""
    warnings.simplefilter("error")
    rows = [row for row in json.loads((root / "index.json").read_text()) if not row["denied"]]
    # Whatever is loaded on first use (codecs, the schema) is loaded by the first three, before the guard.
    for name in ("unknown_key", "checksum", "hardlink"):
        read(root / name / f"{name}.triasset")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    # Opened now, read later: no such file may be opened under guard.
    with Path("/proc/self/status").open(encoding="ascii") as status:
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT, used + LIMIT))
        guard(root)
        for row in rows:
            codes = read(root / row["file"])
            if row["found_by"] != "command" and row["code"] not in codes:
                fail(f"{row['name']} gives {codes}")
        peak = peak_mib(status)
    if peak > MOST_MIB:
        fail(f"used {peak} MiB at most")
    sys.stdout.write(f"{len(rows)} cases\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
