"""Every bad checkpoint there is. Nothing in them is random: the same release writes the same bytes."""

from __future__ import annotations

from pathlib import Path

from tests.adapters import bad_archives, bad_pickles, bad_results, bad_tensors
from tests.adapters.assemble import Case

CASES: tuple[Case, ...] = (*bad_archives.CASES, *bad_pickles.CASES, *bad_results.CASES, *bad_tensors.CASES)


def file_name(case: Case) -> str:
    return "".join(c if c.isalnum() else "_" for c in case.name) + ".pt"


def write_case(case: Case, root: Path) -> Path:
    """Write one case below `root` and return its path."""
    path = root / file_name(case)
    path.write_bytes(case.make())
    return path
