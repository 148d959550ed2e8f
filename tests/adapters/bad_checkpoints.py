"""Every bad checkpoint there is; `python -m tests.adapters.bad_checkpoints OUTDIR` writes them all.

Nothing in them is random: the same release writes the same bytes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tests.adapters import bad_archives, bad_pickles, bad_results, bad_tensors

if TYPE_CHECKING:
    from tests.adapters.assemble import Case

CASES: tuple[Case, ...] = (
    *bad_archives.CASES,
    *bad_pickles.CASES,
    *bad_results.CASES,
    *bad_tensors.CASES,
)


def file_name(case: Case) -> str:
    return "".join(c if c.isalnum() else "_" for c in case.name) + ".pt"


def write_case(case: Case, root: Path) -> Path:
    """Write one case below `root` and return its path."""
    path = root / file_name(case)
    path.write_bytes(case.make())
    return path


def write_all(root: Path) -> None:
    """Write all cases below `root`, and index.json beside them."""
    root.mkdir(parents=True)
    rows = []
    for case in CASES:
        path = write_case(case, root)
        rows.append({"file": path.name, "name": case.name, "title": case.title, "code": case.code})
    (root / "index.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m tests.adapters.bad_checkpoints OUTDIR")
    write_all(Path(sys.argv[1]))
    print(f"{len(CASES)} bad checkpoints in {sys.argv[1]}")
