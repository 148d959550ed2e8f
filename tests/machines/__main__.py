"""Run the rendering tests on other OpenCL platforms: `python -m tests.machines [NAME ...]`, or `make
test-all`.

Each platform is the only one that is registered with the OpenCL loader, and it is chosen by name, because the
loader always finds the PoCL of the wheel as well. A platform that is not installed is skipped with a message
that names its package.
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

from msb.cl import pocl_fix
from tests.conftest import ROOT, UNKNOWN_CPU, list_skips

VENDORS = Path("/etc/OpenCL/vendors")
ALL_CORES = "-n", "auto", "--dist", "worksteal"
SHOW = (
    "from msb.cl.devices import choose_device, try_devices\n"
    "selector = choose_device().record.selector\n"
    "device = next(device for device in try_devices() if device.record.selector == selector)\n"
    "print(device.record, f'style {device.record.style}', *filter(None, [device.trial.mended]), sep='; ')"
)
"""Program that prints the chosen device, the style of its kernels, and a repair of the wheel, if any."""


class Machine(NamedTuple):
    """An OpenCL platform.

    Attributes
    ----------
    package : str
        Package of Debian or pip.
    library : str
        Part of the name of its library; "" for the PoCL of the wheel, which the loader finds without an
        entry.
    device : str
        Value of MSB_DEVICE.
    environment : dict
        Further environment variables.
    tests : tuple of str
        Arguments of pytest.
    """

    package: str
    library: str
    device: str
    environment: dict[str, str]
    tests: tuple[str, ...]


PLATFORM_INDEPENDENT = ("cl/test_loader", "cl/test_trial", "render/test_arguments", "render/test_images")
"""Tests that set up their platform themselves, and tests that run no kernel."""
# Arguments of pytest. Slow tests are left out: they run the same kernels on larger and random scenes.
QUICK = *ALL_CORES, "-m", "not slow", *(f"--ignore=tests/{name}.py" for name in PLATFORM_INDEPENDENT)
CPU_STYLE = "-k", "not gpu"
"""Arguments of pytest that skip the GPU style of the kernels, which is not the default on a CPU."""
GOLDEN = tuple(f"tests/render/test_{name}.py" for name in ("diffsoup", "splatting_golden", "standard"))
PICTURES = (
    "tests/bake/test_soup_renderer.py",
    *GOLDEN,
    *(f"tests/render/test_{name}.py" for name in ("splat_shares", "work_groups")),
)
COMPARED = tuple(f"tests/render/test_{name}.py" for name in ("splat_order", "splatting", "standard_far"))
MACHINES = {
    # The PoCL of the system, which is another version than in the wheel. `make test` runs both styles of
    # kernels with the wheel. Left out: tests that do not depend on the compiler, such as tests of inputs.
    "pocl": Machine(
        "pocl-opencl-icd",
        "libpocl",
        "pocl:0",
        {},
        (*QUICK, *CPU_STYLE, "tests/cl", *PICTURES, *COMPARED),
    ),
    # The PoCL of the wheel on a processor that it does not know. msb must repair the wheel for it. The
    # library is the same as in `make test`, but it compiles kernels to other machine code.
    "unknown": Machine(
        "pocl-binary-distribution",
        "",
        "pocl",
        {"PYTHONPATH": str(UNKNOWN_CPU)},
        (*QUICK, *CPU_STYLE, "tests/cl/test_scan_sort.py", *GOLDEN),
    ),
    # GPU style; tests of the CPU style are skipped. Golden images and work-groups are tested. Large scenes,
    # random scenes and comparisons with the references are left out, because llvmpipe takes minutes for them.
    "rusticl": Machine(
        "mesa-opencl-icd",
        "libRusticlOpenCL",
        "rusticl",
        {"RUSTICL_ENABLE": "llvmpipe"},
        (*QUICK, "-k", "not 8k", "tests/cl", *PICTURES),
    ),
    # GPU style, on an NVIDIA GPU. The driver includes OpenCL, but containers do not register it with the
    # loader.
    "nvidia": Machine(
        "nvidia-opencl-icd", "libnvidia-opencl", "nvidia", {}, (*QUICK, "tests/cl", *PICTURES, *COMPARED)
    ),
    # An interpreter that detects data races. It is about 1000 times slower, so each kind of scene is small.
    "oclgrind": Machine(
        "oclgrind",
        "liboclgrind-rt-icd",
        "oclgrind",
        {
            "OCLGRIND_CHECK_API": "1",
            "OCLGRIND_DATA_RACES": "1",
            # Optimised code has intrinsics that the interpreter does not support.
            "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",
            "OCLGRIND_MAX_ERRORS": "1000000",
            # Oclgrind allocates memory for each work-item. Keep freed memory in the process: returning it to
            # the system each time takes 50 % longer.
            "MALLOC_TRIM_THRESHOLD_": "4000000000",
            "MALLOC_TOP_PAD_": "67108864",
        },
        (*ALL_CORES, "tests/machines/oclgrind_scenes.py"),
    ),
}


def find_library_name(machine: Machine) -> str | None:
    """Return the library for the loader's entry, or the version of the wheel; None if not installed."""
    if not machine.library:
        try:
            return metadata.distribution(machine.package).version
        except metadata.PackageNotFoundError:
            return None
    files = sorted(VENDORS.glob("*.icd"))
    registered = [line.strip() for file in files for line in file.read_text().splitlines()]
    unregistered = map(str, Path("/usr/lib").glob("oclgrind/*.so"))  # Debian does not register Oclgrind
    loadable = find_library(machine.library.removeprefix("lib")) or ""
    return next((name for name in (*registered, *unregistered, loadable) if machine.library in name), None)


def describe_device(environment: dict[str, str]) -> str:
    """Return the device that a process with this environment chooses, or "none: " and the error."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else "none: " + done.stderr.strip()[-300:]


def skip(reason: str) -> bool:
    """Print why the tests of a platform are skipped; return True, because no test failed."""
    print(f"skipped {reason}", flush=True)
    list_skips([f"machine {reason}"])
    return True


def run(name: str) -> bool:
    """Run the tests on a platform if it is installed; return whether they passed."""
    machine = MACHINES[name]
    library = find_library_name(machine)
    if library is None:
        return skip(f"{name}: {machine.package} is not installed")
    if name == "unknown" and (lacks := pocl_fix.obstacle()):
        return skip(f"{name}: {lacks}")
    with tempfile.TemporaryDirectory(prefix="msb-machine-") as folder:
        environment = {**os.environ, "OCL_ICD_VENDORS": folder, "MSB_DEVICE": machine.device}
        for variable in ("POCL_CACHE_DIR", "PYOPENCL_CTX"):
            environment.pop(variable, None)
        without = describe_device(environment) if machine.library else ""
        environment |= machine.environment
        if machine.library:
            Path(folder, f"{name}.icd").write_text(f"{library}\n")
        device = describe_device(environment)
        if device == without or device.startswith("none"):
            print(f"{name}: FAILED, {library} is installed, but the chosen device is {device}", flush=True)
            return False
        print(f"{name}: {device}", flush=True)
        start = time.monotonic()
        command = sys.executable, "-m", "pytest", "-q", *machine.tests
        passed = subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode == 0
    print(f"{name}: {'passed' if passed else 'FAILED'} in {time.monotonic() - start:.0f} s", flush=True)
    return passed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "machines", nargs="*", metavar="NAME", help=f"one of {', '.join(MACHINES)}; default: all"
    )
    names = parser.parse_args().machines or list(MACHINES)
    unknown = sorted({*names} - {*MACHINES})
    if unknown:
        parser.error(f"unknown platform {', '.join(unknown)}; choose from {', '.join(MACHINES)}")
    results = [run(name) for name in names]
    return 0 if all(results) else 1


if __name__ == "__main__":
    raise SystemExit(main())
