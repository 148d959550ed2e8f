"""Every bad asset there is: `python -m tests.corpus.bad_assets OUTDIR` writes them all, with an index.

Each case has a folder of its own, since some need files beside the asset. Nothing in them is random: the
same release writes the same bytes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tests.corpus import (
    bad_buffers,
    bad_fields,
    bad_files,
    bad_paths,
    bad_texts,
    bad_values,
    bad_zip_members,
    bad_zips,
)

if TYPE_CHECKING:
    from tests.corpus.case import Case

CASES: tuple[Case, ...] = tuple(
    case
    for module in (
        bad_texts,
        bad_fields,
        bad_paths,
        bad_buffers,
        bad_values,
        bad_zips,
        bad_zip_members,
        bad_files,
    )
    for case in module.CASES
)


def write_case(case: Case, root: Path) -> Path:
    """Write one case below `root` and return the path of the asset."""
    path = root / case.name / f"{case.name}.triasset"
    path.parent.mkdir(parents=True)
    case.write(path)
    return path


def write_all(root: Path) -> None:
    """Write all cases below `root`, and index.json beside them."""
    rows = []
    for case in CASES:
        path = write_case(case, root)
        rows.append(
            {
                "file": str(path.relative_to(root)),
                "name": case.name,
                "title": case.title,
                "code": case.code,
                "severity": case.severity,
                "found_by": case.found_by,
                "denied": case.denied,
            }
        )
    (root / "index.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m tests.corpus.bad_assets OUTDIR")
    write_all(Path(sys.argv[1]))
    print(f"{len(CASES)} bad assets in {sys.argv[1]}")
