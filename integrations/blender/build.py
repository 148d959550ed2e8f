"""Build the extension for Blender: ``python integrations/blender/build.py``.

Run this script on the target system, with the Python version of the target Blender. The ZIP file contains the
sources beside this file, a wheel of this repository and the wheels it depends on, which pip downloads. NumPy
comes with Blender.
"""

from __future__ import annotations

import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = Path(__file__).resolve().parent / "meshsplatbench"
# The NumPy of each Python version. Blender 4.2 to 5.0 has Python 3.11; Blender 5.1 and later have 3.13.
NUMPY = {(3, 11): "numpy<2", (3, 13): "numpy>=2"}
# Blender's name of a processor, by Python's name, for the processors with different names.
MACHINES = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}


def fetch_wheels(folder: Path) -> list[Path]:
    """Build our wheel and download its dependencies into `folder`; return all wheels except NumPy."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT], check=True)
    (ours,) = folder.glob("*.whl")
    requirements = [str(ours), NUMPY[sys.version_info[:2]]]
    subprocess.run([*pip, "download", "--only-binary=:all:", "--dest", folder, *requirements], check=True)
    return sorted(path for path in folder.glob("*.whl") if not path.name.startswith("numpy-"))


def system_name() -> str:
    """Return Blender's name of this system, such as "linux-x64"."""
    system = {"darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    return f"{system}-{MACHINES.get(machine, machine)}"


def build(target: Path, wheels: list[Path], system: str) -> None:
    """Write the extension with `wheels` to the ZIP file `target`, and complete its manifest."""
    version = re.search(r'__version__ = "(.+)"', (ROOT / "msb" / "base" / "version.py").read_text("utf-8"))
    assert version is not None
    listed = "".join(f'  "./wheels/{path.name}",\n' for path in wheels)
    manifest = (SOURCES / "blender_manifest.toml").read_text("utf-8")
    head = f'version = "{version[1]}"\nplatforms = ["{system}"]\nwheels = [\n{listed}]\n'
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "blender_manifest.toml", manifest.replace("\n[permissions]", f"{head}\n[permissions]")
        )
        for path in sorted(SOURCES.glob("*.py")):
            archive.write(path, path.name)
        for path in wheels:
            archive.write(path, f"wheels/{path.name}", zipfile.ZIP_STORED)


def main() -> None:
    """Build the extension for this system and this version of Python."""
    if sys.version_info[:2] not in NUMPY:
        sys.exit(
            "Run build.py with your Blender's Python: 3.11 for Blender 4.2 to 5.0, 3.13 for 5.1 and later"
        )
    name = f"meshsplatbench-blender-{system_name()}-py{sys.version_info[0]}.{sys.version_info[1]}.zip"
    with tempfile.TemporaryDirectory() as folder:
        target = ROOT / "build" / name
        build(target, fetch_wheels(Path(folder)), system_name())
    print(f"{target}: {target.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
