"""Every bad asset there is.

Each case has a folder of its own, since some need files beside the asset. Nothing in them is random: the
same release writes the same bytes.
"""

from __future__ import annotations

from pathlib import Path

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
