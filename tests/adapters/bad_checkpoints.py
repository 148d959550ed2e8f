"""All bad checkpoints. They contain no random values, so the bytes are the same each time."""

from pathlib import Path
from typing import Any

from msb.adapters.checkpoint import read_checkpoint
from tests.adapters import bad_archives, bad_pickles, bad_tensors
from tests.adapters.assemble import Case

CASES: tuple[Case, ...] = (*bad_archives.CASES, *bad_pickles.CASES, *bad_tensors.CASES)


def write_case(case: Case, root: Path) -> Path:
    """Write one case below `root` and return its path."""
    path = root / ("".join(c if c.isalnum() else "_" for c in case.name) + ".pt")
    path.write_bytes(case.make())
    return path


def read_case(case: Case, root: Path) -> Any:
    """Write one case below `root`, and read it."""
    return read_checkpoint(write_case(case, root))
