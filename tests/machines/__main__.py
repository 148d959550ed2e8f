"""The tests that draw, on other OpenCL platforms: `python -m tests.machines [NAME ...]`, or `make test-all`.

A platform is shown to the loader alone, and chosen by name: the PoCL of the wheel is always found as well.
What is not installed is skipped, with the package to install.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from ctypes.util import find_library
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from msb.cl import mend
from tests.conftest import ROOT, UNKNOWN_CPU, list_skips

VENDORS = Path("/etc/OpenCL/vendors")
ALL_CORES = "-n", "auto", "--dist", "worksteal"
SHOW = (
    "from msb.cl.devices import choose_device, try_devices\n"
    "taken = choose_device().record.selector\n"
    "found = next(device for device in try_devices() if device.record.selector == taken)\n"
    "print(found.record, f'style {found.record.style}', *filter(None, [found.trial.mended]), sep='; ')"
)


class Machine(NamedTuple):
    """A platform: its package (Debian's, or pip's), its MSB_DEVICE, what else it needs, and pytest's words.

    `library` is part of the name of its library; "" for the wheel's, which the loader finds itself.
    """

    package: str
    library: str
    device: str
    environment: dict[str, str]
    tests: tuple[str, ...]


ELSEWHERE_ALIKE = ("cl/test_loader", "cl/test_trial", "render/test_arguments", "render/test_images")
"""How platforms are found and tried, which each of these tests sets up itself; and what runs no kernel."""
# The slow ones are the same kernels on larger and random scenes.
QUICK = *ALL_CORES, "-m", "not slow", *(f"--ignore=tests/{name}.py" for name in ELSEWHERE_ALIKE)
OWN_STYLE = "-k", "not gpu"
"""On a CPU, nobody draws by the kernels for a GPU but who asks for them."""
GOLDEN = tuple(f"tests/render/test_{name}.py" for name in ("diffsoup", "splatting_golden", "standard"))
PICTURES = (
    "tests/bake/test_raster.py",
    *GOLDEN,
    *(f"tests/render/test_{name}.py" for name in ("splat_shares", "work_groups")),
)
COMPARED = tuple(f"tests/render/test_{name}.py" for name in ("splat_order", "splatting", "standard_far"))
MACHINES = {
    # The system's PoCL, another version; `make test` has the wheel's alone, and both styles of kernels. What
    # renderers do with their input, and share, is no compiler's business.
    "pocl": Machine(
        "pocl-opencl-icd",
        "libpocl",
        "pocl:0",
        {},
        (*QUICK, *OWN_STYLE, "tests/cl", *PICTURES, *COMPARED),
    ),
    # As on a processor that the wheel does not know, so that it has to be mended: the same library otherwise,
    # which makes other machine code.
    "unknown": Machine(
        "pocl-binary-distribution",
        "",
        "pocl",
        {"PYTHONPATH": str(UNKNOWN_CPU)},
        (*QUICK, *OWN_STYLE, "tests/cl/test_scan_sort.py", *GOLDEN),
    ),
    # Style gpu; tests of the other one are skipped. llvmpipe takes minutes for what is left out: large and
    # random scenes, comparisons with the references. Golden images and work-groups are in.
    "rusticl": Machine(
        "mesa-opencl-icd",
        "libRusticlOpenCL",
        "rusticl",
        {"RUSTICL_ENABLE": "llvmpipe"},
        (*QUICK, "-k", "not 8k", "tests/cl", *PICTURES),
    ),
    # Style gpu, on a card; its driver brings OpenCL, in containers without an entry for the loader.
    "nvidia": Machine(
        "nvidia-opencl-icd", "libnvidia-opencl", "nvidia", {}, (*QUICK, "tests/cl", *PICTURES, *COMPARED)
    ),
    # An interpreter that looks for races, a thousand times as slow: a small scene of each kind.
    "oclgrind": Machine(
        "oclgrind",
        "liboclgrind-rt-icd",
        "oclgrind",
        {
            "OCLGRIND_CHECK_API": "1",
            "OCLGRIND_DATA_RACES": "1",
            # Optimised code has intrinsics that the interpreter does not know.
            "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",
            "OCLGRIND_MAX_ERRORS": "1000000",
            # It allocates for each work-item; to give that back each time takes half as long again.
            "MALLOC_TRIM_THRESHOLD_": "4000000000",
            "MALLOC_TOP_PAD_": "67108864",
        },
        (*ALL_CORES, "tests/machines/oclgrind_scenes.py"),
    ),
}


def library_of(machine: Machine) -> str | None:
    """Return what an entry for the loader has to name, None where the machine is not installed."""
    if not machine.library:
        try:
            return metadata.distribution(machine.package).version
        except metadata.PackageNotFoundError:
            return None
    named = [line.strip() for file in sorted(VENDORS.glob("*.icd")) for line in file.read_text().splitlines()]
    beside = map(str, Path("/usr/lib").glob("oclgrind/*.so"))  # Debian registers no entry for it
    loadable = find_library(machine.library.removeprefix("lib")) or ""
    return next((name for name in (*named, *beside, loadable) if machine.library in name), None)


def shown(environment: dict[str, str]) -> str:
    """Return which device a process with that environment takes."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else "none: " + done.stderr.strip()[-300:]


def skip(reason: str) -> bool:
    """Say why the tests of a machine do not run; return that none failed."""
    print(f"skipped {reason}", flush=True)
    list_skips([f"machine {reason}"])
    return True


def run(name: str) -> bool:
    """Run the tests of a machine, if it is there; return whether they passed."""
    machine = MACHINES[name]
    library = library_of(machine)
    if library is None:
        return skip(f"{name}: {machine.package} is not installed")
    if name == "unknown" and (lacks := mend.hindrance()):
        return skip(f"{name}: {lacks}")
    with tempfile.TemporaryDirectory(prefix="msb-machine-") as folder:
        environment = {**os.environ, "OCL_ICD_VENDORS": folder, "MSB_DEVICE": machine.device}
        for variable in ("POCL_CACHE_DIR", "PYOPENCL_CTX"):
            environment.pop(variable, None)
        without = shown(environment) if machine.library else ""
        environment |= machine.environment
        if machine.library:
            Path(folder, f"{name}.icd").write_text(f"{library}\n")
        device = shown(environment)
        if device == without or device.startswith("none"):
            print(f"{name}: FAILED, {library} is there and what is taken is {device}", flush=True)
            return False
        print(f"{name}: {device}", flush=True)
        start = time.monotonic()
        command = sys.executable, "-m", "pytest", "-q", *machine.tests
        passed = subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode == 0
    print(f"{name}: {'passed' if passed else 'FAILED'} in {time.monotonic() - start:.0f} s", flush=True)
    return passed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", metavar="NAME", help=f"of {', '.join(MACHINES)}; default: all")
    chosen = parser.parse_args().machines or list(MACHINES)
    unknown = sorted({*chosen} - {*MACHINES})
    if unknown:
        parser.error(f"{', '.join(unknown)}: there are {', '.join(MACHINES)}")
    results = [run(name) for name in chosen]
    return 0 if all(results) else 1


if __name__ == "__main__":
    raise SystemExit(main())
