"""What PoCL has compiled for one session of tests serves the next: compiling is a third of `make test`.

A session works on a copy of its own, and what it leaves is kept only if all its tests passed: what a killed
compiler leaves behind decides no test. PoCL itself tells programs, options and processors apart.
"""

import hashlib
import shutil
import sys
import sysconfig
import tempfile
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from msb.cl.loader import user_cache

SOURCES = Path(__file__).parent.parent / "msb"


def kept() -> Path:
    """Return the user's folder for the kernels as they are now, and this PoCL."""
    wheel = metadata.version("pocl-binary-distribution")
    digest = hashlib.sha256("\n".join([wheel, sys.version, sysconfig.get_platform()]).encode())
    for path in sorted(SOURCES.rglob("*.cl")):
        digest.update(path.read_bytes())
    cache = user_cache()
    if cache is None:
        raise FileNotFoundError("a user without a home keeps nothing")
    return cache / "meshsplatbench" / f"kernels-{digest.hexdigest()[:12]}"


def copy_to(folder: Path) -> int:
    """Copy what is kept, if anything, and return the number of files."""
    with suppress(OSError, metadata.PackageNotFoundError):  # it only costs time
        shutil.copytree(kept(), folder, dirs_exist_ok=True)
    return _count(folder)


def keep(folder: Path, before: int) -> None:
    """Put `folder` in the place of what is kept if more is in it than `before`, and drop other kernels."""
    if _count(folder) == before:
        return
    with suppress(OSError, metadata.PackageNotFoundError):
        place = kept()
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="made-", dir=place.parent) as made:
            shutil.copytree(folder, Path(made, "new"), ignore=shutil.ignore_patterns("tempfile_*"))
            for old in place.parent.glob("kernels-*"):
                old.rename(Path(made, old.name))
            Path(made, "new").rename(place)


def _count(folder: Path) -> int:
    return sum(1 for path in folder.rglob("*") if path.is_file() and not path.name.startswith("tempfile_"))
