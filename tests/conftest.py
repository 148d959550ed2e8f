"""Set-up, fixtures and small data that all tests share."""

import gc
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tests import kernel_cache
from tests.browser import Browser
from tests.validator import WRITTEN, Validator, keep_written, missing

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared"
UNKNOWN_CPU = ROOT / "tests" / "cl" / "unknown_cpu"
"""A folder for PYTHONPATH. With this variable, the PoCL wheel behaves as on an unknown processor."""
SHORT = {
    "bake": {"--seconds": "0"},
    "bench": {"--repeat": "2", "--seconds": "0"},
    "report": {"--topology": "none"},
    "view": {"--size": "320x240"},
}
"""Options that make commands faster, for tests that only check the exit status."""


def shorten(words: Sequence[str]) -> list[str]:
    """Return a command line (with its program). Options of `SHORT` that the command line lacks are added."""
    typed = {word.partition("=")[0] for word in words}
    options = SHORT.get(words[1], {}) if words[0] == "msb" and len(words) > 1 else {}
    added = [word for flag, value in options.items() if flag not in typed for word in (flag, value)]
    return [*words[:2], *added, *words[2:]] if "--help" not in words else list(words)


CAPABILITIES = {
    "bake": ("msb/bake", "tests/bake"),
    "lod": ("msb/lod", "tests/lod"),
    "trial": ("msb/trial", "tests/trial"),
    "why": ("msb/why", "tests/why"),
    "score": ("msb/score", "tests/score"),
    "bench": ("msb/bench", "msb/report", "tests/bench", "tests/report", "tests/benchmarks", "benchmarks"),
    "engines": ("msb/engines", "tests/engines"),
    "viewers": ("viewers", "tests/viewers"),
}
"""The folders of each capability, which can be deleted together (tests/test_deletable.py)."""
WHOLE = all((ROOT / folder).is_dir() for folders in CAPABILITIES.values() for folder in folders[:1])
of_the_whole = pytest.mark.skipif(not WHOLE, reason="a capability was removed")
"""Mark of tests that need all capabilities."""


KERNELS = pytest.StashKey[tuple[Path, int]]()
"""The kernel cache of this session, and its initial number of files."""


def pytest_configure(config: pytest.Config) -> None:
    """Isolate this session and its child processes from the OpenCL set-up of the system.

    These processes get a separate kernel cache, and PoCL's wheel as the only platform. Tests are then
    independent of damaged caches, other versions of the kernels and other platforms of the system.
    Environment variables that are already set, for example by `tests.machines`, are not changed. Hypothesis
    runs without a time limit.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # shells ignore SIGINT for background processes
        signal.signal(signal.SIGINT, signal.default_int_handler)
    variables = {"POCL_CACHE_DIR"} - os.environ.keys()
    if not {"OCL_ICD_VENDORS", "MSB_DEVICE"} & os.environ.keys() and _the_wheel_is_installed():
        variables.add("OCL_ICD_VENDORS")  # with an empty folder the loader only finds the wheel
    for variable in variables:
        folder = tempfile.TemporaryDirectory(prefix="msb-test-", ignore_cleanup_errors=True)
        os.environ[variable] = folder.name
        config.add_cleanup(folder.cleanup)
        if variable == "POCL_CACHE_DIR":
            config.stash[KERNELS] = Path(folder.name), kernel_cache.copy_to(Path(folder.name))
    settings.register_profile("ours", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("ours")


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Keep the compiled kernels if all tests passed."""
    if exitstatus == 0 and KERNELS in session.config.stash:
        kernel_cache.keep(*session.config.stash[KERNELS])


def pytest_collection_finish() -> None:
    """Exclude the thousands of collected tests from garbage collection."""
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Pass the reasons of skipped tests to `list_skips`, except in worker processes."""
    if hasattr(terminalreporter.config, "workerinput"):
        return
    reasons = (str(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", ()))
    list_skips(reason.removeprefix("Skipped: ") for reason in reasons)


def list_skips(reasons: Iterable[str]) -> None:
    """Append reasons to the file that MSB_TEST_SKIPS names. The file collects skips of several sessions."""
    if file := os.environ.get("MSB_TEST_SKIPS"):
        with Path(file).open("a", encoding="utf-8") as stream:
            stream.writelines(f"{reason}\n" for reason in reasons)


def _the_wheel_is_installed() -> bool:
    try:
        return bool(metadata.version("pocl-binary-distribution"))
    except metadata.PackageNotFoundError:
        return False


@pytest.fixture(scope="session")
def validator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Validator | None]:
    """Return the official glTF-Validator, or None if it is not installed."""
    if missing():
        yield None
        return
    opened = Validator(tmp_path_factory.mktemp("written"))
    os.environ[WRITTEN] = str(opened.written)
    keep_written(opened.written)
    yield opened
    opened.close()


@pytest.fixture(autouse=True)
def _valid_glbs(validator: Validator | None) -> Iterator[None]:
    """Check that GLB files written by the test or by its commands have no errors and no warnings."""
    yield
    if validator is not None:
        assert validator.judge_written() == {}


@pytest.fixture(scope="session")
def demo_asset() -> Path:
    """Return the shipped asset that resembles MeshSplatting."""
    return ROOT / "data_stubs" / "splat_like.triasset"


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the folder of external data, which is never committed. Skip the test if it is missing."""
    if not (SHARED / "golden").is_dir():
        pytest.skip(f"the shared data folder is absent ({SHARED.name} beside the repository)")
    return SHARED


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Return a browser for the whole session. Skip the test without Chromium."""
    from msb.engines.browser import find_browser

    if (program := find_browser()) is None or os.name == "nt":
        pytest.skip("Chromium is not installed")
    opened = Browser(program, tmp_path_factory.mktemp("browser"))
    yield opened
    opened.close()


@pytest.fixture
def in_browser(browser: Browser) -> Callable[..., Any]:
    """Return `Browser.show`. The browser opens a page, runs a script in it and returns the result."""
    return browser.show


@pytest.fixture
def unknown(tmp_path: Path) -> dict[str, str]:
    """Return environment variables that make the PoCL wheel behave as on an unknown processor."""
    from msb.cl import loader, pocl_fix
    from msb.cl.devices import find_devices

    if not any(pocl_fix.is_wheel(handle) for _, handle in find_devices(loader.opencl())):
        pytest.skip("the PoCL wheel is not installed")
    if pocl_fix.obstacle():
        pytest.skip(f"the wheel cannot be repaired on this machine: {pocl_fix.obstacle()}")
    return {
        "PYTHONPATH": f"{UNKNOWN_CPU}{os.pathsep}{ROOT}",
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "OCL_ICD_VENDORS": str(tmp_path),
        **dict.fromkeys((pocl_fix.FIX_VARIABLE, "MSB_DEVICE", "PYOPENCL_CTX"), ""),
    }


TETRAHEDRON = (
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)
BOOK = (
    np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]], np.float32),
    np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
)
