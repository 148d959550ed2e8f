"""The search for platforms. It runs in child processes, because a loader starts only once per process."""

import os
import sys
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

import pytest

from msb.cl import list_devices, loader, open_device
from msb.cl.loader import INTEL_LIBRARY, INTEL_PACKAGE
from msb.errors import DeviceError
from tests.cl.conftest import Child, answer
from tests.conftest import ROOT

LIST = """
import os
before = dict(os.environ)
from msb.cl import list_devices
from msb.cl.loader import notes
print(*(record.selector for record in list_devices()), *notes(), sep="|")
import pyopencl
before["PYOPENCL_HOME"] = os.environ["PYOPENCL_HOME"]  # set by pyopencl
assert dict(os.environ) == before, "the environment was not restored"
"""
OPEN = """
from msb.cl import open_device
from msb.errors import DeviceError
try:
    open_device()
except DeviceError as error:
    print(error)
"""
SORT = """
import numpy as np
from msb.cl import open_device
from msb.cl.sort import sort_pairs
with open_device("pocl") as device:
    keys = np.random.default_rng(0).integers(0, 2**32, 5000, np.uint32)
    ordered, order = sort_pairs(device, device.upload(keys))
    assert (ordered.read() == np.sort(keys)).all()
    print(*device.program("radix_cpu", {"KEY": "uint", "DIGITS": 256})._kernels)
"""
SCALE = """
import numpy as np
from msb.cl import open_device
with open_device("pocl") as device:
    program = device.program("simple", {"OFFSET": 0}, "tests.cl.kernels")
    out = device.allocate(5, np.float32)
    program.scaled(5, 1, device.upload(np.arange(5, dtype=np.float32)), out, np.uint32(5))
    print(*out.read())
"""
NOTHING_SET = dict.fromkeys((loader.VENDOR_VARIABLE, "MSB_DEVICE", "PYOPENCL_CTX", "POCL_DEVICES"))


def test_heavy_modules_are_imported_on_first_use(child: Child) -> None:
    code = "import sys, msb.cl, msb.cl.sort, msb.meshes, msb.metrics\n"
    code += "from msb.topology.explain import explain\nexplain('E'); msb.metrics.psnr; print(*sys.modules)"
    heavy = {"pyopencl", "scipy", "skimage", "trimesh", "PIL", "OpenEXR", "torch", "rich"}
    heavy |= {"igl", "pymeshlab", "networkx"}
    assert not heavy & set(answer(child(code)).split())


@pytest.mark.slow
def test_pocl_is_found_without_settings(child: Child) -> None:
    assert "pocl:0" in answer(child(LIST, **NOTHING_SET)).split("|")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variable", "folder", "more"),
    [
        ("OCL_ICD_VENDORS", "absent", {}),  # the loader of the pyopencl wheel then finds nothing at all
        ("POCL_DEVICES", "", {"POCL_DEVICES": "no_such_driver", "MSB_DEVICE": "pocl"}),
    ],
)
def test_error_names_the_variable_that_hides_all_devices(
    child: Child, tmp_path: Path, variable: str, folder: str, more: dict[str, str]
) -> None:
    # With an empty folder the loader finds only the PoCL wheel.
    env = {**NOTHING_SET, "OCL_ICD_VENDORS": str(tmp_path / folder), **more}
    line = answer(child(OPEN, **env))
    assert line.startswith("DEVICE_NOT_FOUND: ")
    assert variable in line
    assert "\n" not in line


def test_device_list_is_empty_without_platforms(monkeypatch: pytest.MonkeyPatch) -> None:
    cl = loader.opencl()
    error = cl.LogicError(cl._cl._ErrorRecord(msg="", code=-1001, routine="clGetPlatformIDs"))
    monkeypatch.setattr(cl, "get_platforms", Mock(side_effect=error))
    assert list_devices() == []
    with pytest.raises(DeviceError, match="DEVICE_NOT_FOUND"):
        open_device()


def test_driver_without_icd_file_is_registered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(loader, "_SYSTEM_VENDORS", (tmp_path,))
    monkeypatch.setattr(loader, "_find_intel_library", lambda: None)
    monkeypatch.setattr(loader.ctypes, "CDLL", Mock())  # simulates an existing driver library
    monkeypatch.delenv(loader.VENDOR_VARIABLE, raising=False)
    assert loader._find_missing_entries() == {"nvidia": loader.NVIDIA_LIBRARY}
    (tmp_path / "nvidia.icd").write_text(f"{loader.NVIDIA_LIBRARY}\n")
    assert loader._find_missing_entries() == {}


@pytest.mark.slow
def test_missing_pyopencl_is_an_error(child: Child) -> None:
    line = answer(child("import sys\nsys.modules['pyopencl'] = None\n" + OPEN))
    assert line.startswith("DEVICE_NOT_FOUND: pyopencl ")


@pytest.mark.slow
def test_user_without_home_folder_gets_a_temporary_cache(child: Child) -> None:
    code = "import pathlib\ndef none(): raise RuntimeError\npathlib.Path.home = none\n" + LIST
    output = answer(child(code, **{**NOTHING_SET, "XDG_CACHE_HOME": None})).split("|")
    assert "pocl:0" in output
    assert "not writable" in output[-1]


@pytest.mark.slow
def test_processes_at_once_on_an_empty_cache(child: Child, tmp_path: Path) -> None:
    together = [child(SCALE, POCL_CACHE_DIR=str(tmp_path)) for _ in range(3)]
    assert {answer(process) for process in together} == {"0.0 2.0 4.0 6.0 8.0"}


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME"])
def test_unwritable_cache_is_replaced(child: Child, tmp_path: Path, variable: str) -> None:
    """The loader replaces the cache. Without one, PoCL has no device and pyopencl cannot build kernels."""
    (tmp_path / "file").touch()
    env = {**NOTHING_SET, "POCL_CACHE_DIR": None, "XDG_CACHE_HOME": None, variable: str(tmp_path / "file")}
    assert answer(child(SCALE, **env)) == "0.0 2.0 4.0 6.0 8.0"
    devices, note = answer(child(LIST, **env)).split("|")[-2:]
    assert devices.startswith("pocl:")  # the wheel comes last, because the system may have another PoCL
    assert "not writable" in note


@pytest.mark.slow
def test_second_process_uses_the_kernel_cache(child: Child, tmp_path: Path) -> None:
    """The cache has all kernels of a program, except kernels with 16-wide vectors."""
    first = answer(child(SORT, POCL_CACHE_DIR=str(tmp_path)))
    built = {path for path in tmp_path.rglob("*.so") if path.is_file()}
    assert built
    assert answer(child(SORT, POCL_CACHE_DIR=str(tmp_path))) == first
    assert {path for path in tmp_path.rglob("*.so") if path.is_file()} == built


def fake_intel(folder: Path) -> Path:
    """Create the files of the Intel runtime that the loader inspects. Return the folder to import from."""
    site = folder / "site"
    info = site / "intel_opencl_rt-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / "lib").mkdir()
    (folder / "lib" / INTEL_LIBRARY).write_text("not a library")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {INTEL_PACKAGE}\nVersion: 1.0\n")
    (info / "RECORD").write_text(f"../lib/{INTEL_LIBRARY},,\n")
    return site


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the Intel runtime is registered on Linux only")
@pytest.mark.parametrize(
    ("before", "vendors", "note"),
    [
        ("", None, "libtbb.so.12"),
        ("from msb.cl import loader\nloader._preload = lambda folder: None\n", None, INTEL_PACKAGE),
        ("", str(ROOT / "tests"), "OCL_ICD_VENDORS"),  # the setting of the user is respected
    ],
)
def test_unusable_intel_runtime_is_noted_and_ignored(
    child: Child, tmp_path: Path, before: str, vendors: str | None, note: str
) -> None:
    code = f"import sys\nsys.path.insert(0, {str(fake_intel(tmp_path))!r})\n" + before + LIST
    output = answer(child(code, **{**NOTHING_SET, "OCL_ICD_VENDORS": vendors})).split("|")
    assert any(note in text for text in output)
    assert vendors is not None or "pocl:0" in output


def test_system_entries_stay_visible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "one.icd").write_text("libone.so\n")
    (tmp_path / "two.icd").write_text(f"{tmp_path}/libtwo.so\n")
    (tmp_path / "gone.icd").write_text("/no/such/libgone.so\n")
    (tmp_path / "empty.icd").write_text("\n")
    (tmp_path / "libtwo.so").touch()
    monkeypatch.setattr(loader, "_SYSTEM_VENDORS", (tmp_path / "absent", tmp_path))
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    system = loader._read_system_entries()
    assert system == {"one": "libone.so", "two": f"{tmp_path}/libtwo.so"}
    with loader._visible({**system, "nvidia": "libnvidia-opencl.so.1"}):
        folder = Path(os.environ["OCL_ICD_VENDORS"])
        entries = {file.name: file.read_text() for file in folder.iterdir()}
        assert entries == {
            "one.icd": "libone.so\n",
            "two.icd": f"{tmp_path}/libtwo.so\n",
            "nvidia.icd": "libnvidia-opencl.so.1\n",
        }
    assert not folder.exists()
    assert "OCL_ICD_VENDORS" not in os.environ


def intel_is_installed() -> bool:
    try:
        return bool(metadata.version(INTEL_PACKAGE))
    except metadata.PackageNotFoundError:
        return False


@pytest.mark.skipif(not intel_is_installed(), reason="extra intel is not installed")
def test_intel_extra_needs_no_settings_and_agrees_with_pocl(child: Child) -> None:
    output = answer(child(LIST, **{**NOTHING_SET, "LD_LIBRARY_PATH": None})).split("|")
    assert {"intel:0", "pocl:0"} == set(output)
    code = SORT.replace('"pocl"', '"intel"')
    assert answer(child(code, **NOTHING_SET)) == answer(child(SORT, **NOTHING_SET))
    default = "from msb.cl import open_device; print(open_device().record.selector)"
    assert answer(child(default, **NOTHING_SET)) == "pocl:0"
    late = "import pyopencl; pyopencl.get_platforms()\n" + LIST
    assert "msb.cl" in answer(child(late, **NOTHING_SET))
