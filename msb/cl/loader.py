"""Make the OpenCL loader find every installed platform, without any settings.

An OpenCL loader finds platforms through ``*.icd`` files, each with the name of a library (cl_khr_icd). The
loader of the pyopencl wheel reads the ``*.icd`` files of the system and of its own folder. The PoCL wheel
installs its ``*.icd`` file in the folder of the pyopencl loader (`inducer/pyopencl`:
scripts/build-wheels.sh). In two cases an installed platform has no valid ``*.icd`` file. NVIDIA drivers in
containers have no ``*.icd`` file. The ``*.icd`` files of the Intel CPU runtime from PyPI name a missing
folder. For each installation without a valid file, this module writes an ``*.icd`` file into a temporary
folder. The folder also has the ``*.icd`` files of the system. OCL_ICD_VENDORS names the temporary folder
while the loader starts.
"""

import contextlib
import ctypes
import importlib
import os
import platform
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

from msb.base.extras import install
from msb.errors import DeviceError, shorten

# Environment variable that names the folder of ``*.icd`` files. A value of OCL_ICD_VENDORS set by the user
# is kept.
VENDOR_VARIABLE = "OCL_ICD_VENDORS"
INTEL_PACKAGE = "intel-opencl-rt"
INTEL_LIBRARY = "libintelocl.so"
# Libraries that the Intel library links to, in dependency order. The package intel-cmplr-lib-rt has all
# these libraries except TBB.
_INTEL_NEEDS = ("libtbb.so.12", "libintlc.so.5", "libimf.so", "libirng.so", "libsvml.so")
NVIDIA_LIBRARY = "libnvidia-opencl.so.1"
_POCL_CACHE = "POCL_CACHE_DIR"
_POCL_DEVICES = "POCL_DEVICES"
# Minimum free disk space for a cache in bytes: several times the size of all kernels of one device.
_CACHE_BYTES = 1 << 24
_SYSTEM_VENDORS = (Path("/etc/OpenCL/vendors"), Path(sys.prefix, "etc/OpenCL/vendors"))

_lock = threading.Lock()
_started = False
_notes: list[str] = []
_platforms: list[str] = []


def opencl() -> Any:
    """Return the module pyopencl after starting the OpenCL loader."""
    global _started
    with _lock:
        early = "pyopencl" in sys.modules
        try:
            import pyopencl
        except (ImportError, OSError) as error:
            why = shorten(str(error), 200)
            text = f"pyopencl cannot be loaded ({why}); run pip install --force-reinstall pyopencl"
            raise DeviceError("DEVICE_NOT_FOUND", text) from error
        if not _started:
            _start(pyopencl, early)
            _started = True
    return pyopencl


def notes() -> list[str]:
    """Return sentences for the user about the search for platforms."""
    return list(_notes)


def describe_search() -> str:
    """Return a short text about the searched places, and the platforms found there."""
    user = os.environ.get(VENDOR_VARIABLE)
    place = f"{VENDOR_VARIABLE}={shorten(user)}" if user else "system *.icd files and Python packages"
    names = ", ".join(map(shorten, _platforms))
    result = f"found {names} without a usable device" if names else "found no platform"
    return f"searched {place}; {result}"


def how_to_get_a_device() -> str:
    """Return a sentence with advice to get a device: unset the variable that hides it, or install PoCL."""
    if any("Portable" in name for name in _platforms):
        cache = os.environ.get(_POCL_CACHE)
        if cache and not _is_writable(Path(cache)):
            return f"{_POCL_CACHE}={shorten(cache)} is not writable, so PoCL has no device; unset it"
        if os.environ.get(_POCL_DEVICES):
            return f"{_POCL_DEVICES} names a device that PoCL does not have; unset it"
    user = os.environ.get(VENDOR_VARIABLE)
    if user and not Path(user).exists():
        return f"{VENDOR_VARIABLE} names a missing folder, which hides all platforms; unset it"
    return how_to_get_pocl()


def how_to_get_pocl() -> str:
    """Return a sentence with advice to get a CPU device on this machine."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return "install PoCL, which supports any x86-64 processor: pip install pocl-binary-distribution"
    return (
        "install PoCL, which supports any processor, from the packages of your system (pocl-opencl-icd on "
        "Debian and Ubuntu, pocl on Fedora, conda-forge and Homebrew)"
    )


def how_to_get_another() -> str:
    """Return a sentence with advice to get a CPU device without the PoCL wheel."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return (
            "Install a newer PoCL: apt-get install pocl-opencl-icd (Debian, Ubuntu), dnf install pocl "
            "(Fedora), conda install -c conda-forge pocl. Or install the Intel runtime: " + install("intel")
        )
    return how_to_get_pocl().capitalize()


def _start(cl: Any, early: bool) -> None:
    with contextlib.ExitStack() as stack:
        registered: dict[str, str] = {}
        if sys.platform == "linux":
            registered = _find_missing_entries()
            try:
                if registered:
                    stack.enter_context(_visible({**_read_system_entries(), **registered}))
                stack.enter_context(_writable_cache())
            except OSError as error:
                _notes.append(
                    f"cannot create a temporary folder for the OpenCL loader: {shorten(str(error), 200)}"
                )
        importlib.import_module("pyopencl.invoker")  # this call opens a file in the cache

        with contextlib.suppress(cl.Error):
            for candidate in cl.get_platforms():
                _platforms.append(candidate.name.strip())
                candidate.get_devices()  # PoCL reads the environment during this call
    if INTEL_PACKAGE in registered and not any("Intel" in name for name in _platforms):
        cause = (
            "pyopencl was loaded before msb.cl" if early else "the library of the platform cannot be loaded"
        )
        _notes.append(f"{INTEL_PACKAGE} is installed, but its platform is missing: {cause}")


def _find_missing_entries() -> dict[str, str]:
    """Return the libraries, by name, of installed platforms without an ``*.icd`` file.

    The dependencies of the libraries are loaded first.
    """
    user = os.environ.get(VENDOR_VARIABLE)
    known = " ".join(_read_system_entries().values())
    entries: dict[str, str] = {}
    intel = _find_intel_library()
    if intel and INTEL_LIBRARY not in known:
        missing = _preload(intel.parent)
        if user:
            _notes.append(f"{INTEL_PACKAGE} needs an *.icd file in the folder that {VENDOR_VARIABLE} names")
        elif missing:
            _notes.append(f"{INTEL_PACKAGE} requires {missing}: {install('intel')}")
        else:
            entries[INTEL_PACKAGE] = str(intel)
    if not user and "nvidia" not in known:
        with contextlib.suppress(OSError):
            ctypes.CDLL(NVIDIA_LIBRARY)
            entries["nvidia"] = NVIDIA_LIBRARY
    return entries


def _read_system_entries() -> dict[str, str]:
    """Return the existing libraries, by name, that the system's ``*.icd`` files list."""
    entries: dict[str, str] = {}
    for folder in _SYSTEM_VENDORS:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            for file in sorted(folder.glob("*.icd")):
                library = file.read_text("utf-8").strip()
                if library and (not Path(library).is_absolute() or Path(library).exists()):
                    entries.setdefault(file.stem, library)
    return entries


def _find_intel_library() -> Path | None:
    try:
        files = metadata.distribution(INTEL_PACKAGE).files or []
    except metadata.PackageNotFoundError:
        return None
    places = (Path(str(file.locate())).resolve() for file in files if file.name == INTEL_LIBRARY)
    return next((place for place in places if place.is_file()), None)


def _preload(folder: Path) -> str | None:
    """Load the dependencies of the Intel library, so that users need not set LD_LIBRARY_PATH.

    Return the name of a missing library.
    """
    for name in _INTEL_NEEDS:
        try:
            ctypes.CDLL(str(folder / name), mode=ctypes.RTLD_GLOBAL)
        except OSError:
            return name
    return None


@contextlib.contextmanager
def _visible(entries: dict[str, str]) -> Iterator[None]:
    """During the block, make the loader read these ``*.icd`` files and the files in its own folder."""
    with tempfile.TemporaryDirectory(prefix="msb-opencl-") as folder:
        for name, library in entries.items():
            Path(folder, f"{name}.icd").write_text(f"{library}\n", "utf-8")
        with _environment(VENDOR_VARIABLE, folder):
            yield


@contextlib.contextmanager
def _writable_cache() -> Iterator[None]:
    """Give PoCL and pyopencl a writable cache.

    Without a cache, PoCL has no device and pyopencl cannot build kernels.
    """
    cache = user_cache()
    if cache and _is_writable(cache):
        yield
        return
    folder = tempfile.TemporaryDirectory(prefix="msb-cache-", ignore_cleanup_errors=True)
    _temporary_folders.append(folder)
    _notes.append(f"{cache or '~'} is not writable, so every process compiles its kernels again")
    with _environment("XDG_CACHE_HOME", folder.name):
        yield


# Folders to remove when the process ends.
_temporary_folders: list[tempfile.TemporaryDirectory[str]] = []


def user_cache() -> Path | None:
    """Return the cache folder of the user (XDG base directory specification), or None."""
    given = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(given) if given else Path.home() / ".cache"
    except RuntimeError:  # the user has no home directory
        return None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            # PoCL ends the process if the disk is full.
            return shutil.disk_usage(folder).free > _CACHE_BYTES
    except OSError:
        return False


@contextlib.contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
