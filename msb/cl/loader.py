"""Make the OpenCL loader find every platform of this environment, without settings by the user.

A loader finds platforms through one-line files, ``*.icd``, each naming a library (cl_khr_icd). The pyopencl
wheel brings a loader that reads those of the system and those beside itself, where the PoCL wheel puts its
own (`inducer/pyopencl`: scripts/build-wheels.sh). Two kinds of installation have no such file: Intel's CPU
runtime from PyPI, whose files name a folder that does not exist, and NVIDIA drivers in containers. For these
a folder of entries, the system's own included, is made for the moment in which the loader starts; afterwards
the environment is as before.
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

# The environment variable that names the folder of entries; if the user set it, it stays.
VENDOR_VARIABLE = "OCL_ICD_VENDORS"
INTEL_PACKAGE = "intel-opencl-rt"
INTEL_LIBRARY = "libintelocl.so"
# What the Intel library links to, each after what it links to itself; intel-cmplr-lib-rt brings all but TBB.
_INTEL_NEEDS = ("libtbb.so.12", "libintlc.so.5", "libimf.so", "libirng.so", "libsvml.so")
NVIDIA_LIBRARY = "libnvidia-opencl.so.1"
_POCL_CACHE = "POCL_CACHE_DIR"
_POCL_DEVICES = "POCL_DEVICES"
# Bytes that must be free for a cache: several times what all kernels take for one device.
_CACHE_BYTES = 1 << 24
_SYSTEM_VENDORS = (Path("/etc/OpenCL/vendors"), Path(sys.prefix, "etc/OpenCL/vendors"))

_lock = threading.Lock()
_started = False
_notes: list[str] = []
_platforms: list[str] = []


def opencl() -> Any:
    """Return the module pyopencl after its loader was started."""
    global _started
    with _lock:
        early = "pyopencl" in sys.modules
        try:
            import pyopencl
        except (ImportError, OSError) as error:
            why = shorten(str(error), 200)
            text = f"pyopencl cannot be loaded ({why}): pip install --force-reinstall pyopencl"
            raise DeviceError("DEVICE_NOT_FOUND", text) from error
        if not _started:
            _start(pyopencl, early)
            _started = True
    return pyopencl


def notes() -> list[str]:
    """Return sentences about how platforms were looked for that the user should know."""
    return list(_notes)


def looked_for() -> str:
    """Return in a few words where platforms were looked for and which were found."""
    user = os.environ.get(VENDOR_VARIABLE)
    where = f"{VENDOR_VARIABLE}={shorten(user)}" if user else "the system's entries and Python packages"
    names = ", ".join(map(shorten, _platforms))
    return f"looked in {where}; " + (
        f"found {names} without a usable device" if names else "found no platform"
    )


def how_to_get_a_device() -> str:
    """Return in one sentence what to do if no device was found: unset what hides them, or get PoCL."""
    if any("Portable" in name for name in _platforms):
        cache = os.environ.get(_POCL_CACHE)
        if cache and not _is_writable(Path(cache)):
            return f"{_POCL_CACHE}={shorten(cache)} cannot be written, so PoCL has no device; unset it"
        if os.environ.get(_POCL_DEVICES):
            return f"{_POCL_DEVICES} names none that PoCL has; unset it"
    user = os.environ.get(VENDOR_VARIABLE)
    if user and not Path(user).exists():
        return f"{VENDOR_VARIABLE} names nothing that exists, which hides every platform; unset it"
    return how_to_get_pocl()


def how_to_get_pocl() -> str:
    """Return in one sentence how to get a CPU device on this machine."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return "pip install pocl-binary-distribution brings PoCL, which runs on any x86-64 processor"
    return (
        "install PoCL, which runs on any processor, from your system's packages "
        "(pocl-opencl-icd on Debian and Ubuntu, pocl on Fedora, conda-forge and Homebrew)"
    )


def how_to_get_another() -> str:
    """Return in one sentence how to get a CPU device beside the PoCL wheel's."""
    if sys.platform == "linux" and platform.machine() == "x86_64":
        return (
            "Install a newer PoCL: apt-get install pocl-opencl-icd (Debian, Ubuntu), dnf install pocl "
            "(Fedora), conda install -c conda-forge pocl. Or Intel's runtime: " + install("intel")
        )
    return how_to_get_pocl().capitalize()


def _start(cl: Any, early: bool) -> None:
    with contextlib.ExitStack() as stack:
        registered: dict[str, str] = {}
        if sys.platform == "linux":
            registered = _missing_entries()
            try:
                if registered:
                    stack.enter_context(_visible({**_system_entries(), **registered}))
                stack.enter_context(_writable_cache())
            except OSError as error:
                _notes.append(f"no temporary folder for the OpenCL loader: {shorten(str(error), 200)}")
        importlib.import_module("pyopencl.invoker")  # opens a file in the cache

        with contextlib.suppress(cl.Error):
            for one in cl.get_platforms():
                _platforms.append(one.name.strip())
                one.get_devices()  # PoCL reads the environment here, not before
    if INTEL_PACKAGE in registered and not any("Intel" in name for name in _platforms):
        cause = "pyopencl was in use before msb.cl" if early else "its library does not load"
        _notes.append(f"{INTEL_PACKAGE} is installed but its platform does not appear: {cause}")


def _missing_entries() -> dict[str, str]:
    """Return name -> library of the platforms that are installed and have no entry; load what they need."""
    user = os.environ.get(VENDOR_VARIABLE)
    known = " ".join(_system_entries().values())
    entries: dict[str, str] = {}
    intel = _intel_library()
    if intel and INTEL_LIBRARY not in known:
        missing = _preload(intel.parent)
        if user:
            _notes.append(f"{VENDOR_VARIABLE} is set, so {INTEL_PACKAGE} is visible only if it says so")
        elif missing:
            _notes.append(f"{INTEL_PACKAGE} needs {missing}: {install('intel')}")
        else:
            entries[INTEL_PACKAGE] = str(intel)
    if not user and "nvidia" not in known:
        with contextlib.suppress(OSError):
            ctypes.CDLL(NVIDIA_LIBRARY)
            entries["nvidia"] = NVIDIA_LIBRARY
    return entries


def _system_entries() -> dict[str, str]:
    """Return name -> library of the entries of the system whose library can exist."""
    entries: dict[str, str] = {}
    for folder in _SYSTEM_VENDORS:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            for file in sorted(folder.glob("*.icd")):
                library = file.read_text("utf-8").strip()
                if library and (not Path(library).is_absolute() or Path(library).exists()):
                    entries.setdefault(file.stem, library)
    return entries


def _intel_library() -> Path | None:
    try:
        files = metadata.distribution(INTEL_PACKAGE).files or []
    except metadata.PackageNotFoundError:
        return None
    places = (Path(str(file.locate())).resolve() for file in files if file.name == INTEL_LIBRARY)
    return next((place for place in places if place.is_file()), None)


def _preload(folder: Path) -> str | None:
    """Load what the Intel library links to, since nobody set LD_LIBRARY_PATH; return what is missing."""
    for name in _INTEL_NEEDS:
        try:
            ctypes.CDLL(str(folder / name), mode=ctypes.RTLD_GLOBAL)
        except OSError:
            return name
    return None


@contextlib.contextmanager
def _visible(entries: dict[str, str]) -> Iterator[None]:
    """Show the loader these entries, and what lies beside it, while the block runs."""
    with tempfile.TemporaryDirectory(prefix="msb-opencl-") as folder:
        for name, library in entries.items():
            Path(folder, f"{name}.icd").write_text(f"{library}\n", "utf-8")
        with _environment(VENDOR_VARIABLE, folder):
            yield


@contextlib.contextmanager
def _writable_cache() -> Iterator[None]:
    """Show PoCL and pyopencl a cache they can write: PoCL has no device without, pyopencl no kernels."""
    cache = user_cache()
    if cache and _is_writable(cache):
        yield
        return
    folder = tempfile.TemporaryDirectory(prefix="msb-cache-", ignore_cleanup_errors=True)
    _keep.append(folder)
    _notes.append(f"{cache or '~'} cannot be written, so kernels are compiled again in each process")
    with _environment("XDG_CACHE_HOME", folder.name):
        yield


# Folders that are removed when the process ends.
_keep: list[tempfile.TemporaryDirectory[str]] = []


def user_cache() -> Path | None:
    """Return where PoCL, pyopencl and we make our folders (XDG base directory specification), if anywhere."""
    given = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(given) if given else Path.home() / ".cache"
    except RuntimeError:  # a user without a home
        return None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            # Where the disk is full, PoCL's compiler ends the process.
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
