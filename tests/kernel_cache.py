"""Cache of compiled kernels between test sessions.

Without it, compilation takes a third of the time of `make test`. Each session works on a copy of the cache.
The copy replaces the cache only if all tests passed. Incomplete files of a killed compiler then do not affect
later sessions. PoCL itself stores separate files for each program, its options and the processor.
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


def cache_folder() -> Path:
    """Return the cache folder for the current kernels and the installed PoCL."""
    wheel = metadata.version("pocl-binary-distribution")
    digest = hashlib.sha256("\n".join([wheel, sys.version, sysconfig.get_platform()]).encode())
    for path in sorted(SOURCES.rglob("*.cl")):
        digest.update(path.read_bytes())
    cache = user_cache()
    if cache is None:
        raise FileNotFoundError("a user without a home folder has no cache")
    return cache / "meshsplatbench" / f"kernels-{digest.hexdigest()[:12]}"


def copy_to(folder: Path) -> int:
    """Copy the cache, if it exists, to `folder`. Return the number of files in `folder`."""
    with suppress(OSError, metadata.PackageNotFoundError):  # tests also work without the cache, but slower
        shutil.copytree(cache_folder(), folder, dirs_exist_ok=True)
    return _count(folder)


def keep(folder: Path, before: int) -> None:
    """Replace the cache by `folder` if this has more files than `before`.

    Delete caches of other versions of the kernels.
    """
    if _count(folder) == before:
        return
    with suppress(OSError, metadata.PackageNotFoundError):
        place = cache_folder()
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="new-", dir=place.parent) as temporary:
            shutil.copytree(folder, Path(temporary, "new"), ignore=shutil.ignore_patterns("tempfile_*"))
            for old in place.parent.glob("kernels-*"):
                old.rename(Path(temporary, old.name))
            Path(temporary, "new").rename(place)


def _count(folder: Path) -> int:
    return sum(1 for path in folder.rglob("*") if path.is_file() and not path.name.startswith("tempfile_"))
