"""Read every bad checkpoint of a folder in a process that tolerates nothing else: run by the test.

At most 1 GiB of address space beyond what the interpreter and NumPy take; no import, exec, compile, child
process or socket; no file opened that is not in the folder, and none for writing.
"""

from __future__ import annotations

import json
import resource
import sys
import warnings
from pathlib import Path

from msb.adapters.checkpoint import read_checkpoint
from msb.errors import CheckpointError
from tests.asset.guarded_driver import LIMIT, fail, guard, peak_mib

MOST_MIB = 350
"""Peak of resident memory over all cases; the highest is a third of a million tensors of 32 axes."""


def main(root: Path) -> None:
    """Read all cases of the index and print their number."""
    warnings.simplefilter("error")
    rows = json.loads((root / "index.json").read_text())
    read_checkpoint(root / "good.pt")  # whatever is loaded on first use is loaded now
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    # Opened now, read later: no such file may be opened under guard.
    with Path("/proc/self/status").open(encoding="ascii") as status:
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT, used + LIMIT))
        guard(root)
        read_all(root, rows)
        peak = peak_mib(status)
    if peak > MOST_MIB:
        fail(f"used {peak} MiB at most")
    sys.stdout.write(f"{len(rows)} cases, {peak} MiB\n")


def read_all(root: Path, rows: list[dict[str, str]]) -> None:
    """Read every case; end the process at the first that does not give its code."""
    for row in rows:
        try:
            read_checkpoint(root / row["file"])
        except CheckpointError as error:
            if error.code != row["code"]:
                fail(f"{row['name']} gives {error.code}")
        else:
            fail(f"{row['name']} is read")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
