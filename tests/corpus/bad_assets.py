"""All bad assets.

Each case is written to a separate folder, because some cases need files beside the asset. The cases have the
same bytes in every run.
"""

from pathlib import Path

from tests.corpus import bad_folders, bad_manifests, bad_zips
from tests.corpus.case import Case

CASES: tuple[Case, ...] = (*bad_manifests.CASES, *bad_folders.CASES, *bad_zips.CASES)


def write_case(case: Case, root: Path) -> Path:
    """Write a case to a folder below `root` and return the path of the asset."""
    path = root / case.name / f"{case.name}.triasset"
    path.parent.mkdir(parents=True)
    case.write(path)
    return path
