"""Build the extension for Blender: ``python blender/build.py [--platform linux-x64] [--python 3.11]``.

The zip holds the sources beside this file, a wheel of this tree and those that it needs, which pip fetches
for the platform and Python of a Blender; NumPy is Blender's own.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "blender" / "meshsplatbench"
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64", "macosx_12_0_arm64", "macosx_11_0_arm64"),
}
"""Blender's name of a platform -> the tags of wheels that run there."""
NUMPY = {"3.11": "numpy<2", "3.13": "numpy>=2"}
"""Python of a Blender -> its NumPy: 3.11 in Blender 4.2 to 5.0, 3.13 from 5.1 on."""


def fetch_wheels(folder: Path, platform: str, python: str) -> list[Path]:
    """Return a wheel of this tree and the wheels it needs, made and fetched into `folder`."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT], check=True)
    (ours,) = folder.glob("*.whl")
    target = ["--only-binary=:all:", "--python-version", python, "--implementation", "cp"]
    for tag in PLATFORMS[platform]:
        target += ["--platform", tag]
    wanted = [str(ours), NUMPY[python]]
    subprocess.run([*pip, "download", *target, "--dest", folder, *wanted], check=True)
    return sorted(path for path in folder.glob("*.whl") if not path.name.startswith("numpy-"))


def build(target: Path, wheels: list[Path], platform: str) -> None:
    """Write the extension with `wheels` to `target`, the manifest completed."""
    version = re.search(r'__version__ = "(.+)"', (ROOT / "msb" / "base" / "version.py").read_text("utf-8"))
    assert version is not None
    listed = "".join(f'  "./wheels/{path.name}",\n' for path in wheels)
    manifest = (SOURCES / "blender_manifest.toml").read_text("utf-8")
    head = f'version = "{version[1]}"\nplatforms = ["{platform}"]\nwheels = [\n{listed}]\n'
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
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description="Build the extension for Blender.")
    here = {"linux": "linux-x64", "win32": "windows-x64", "darwin": "macos-arm64"}.get(sys.platform)
    parser.add_argument("--platform", choices=PLATFORMS, default=here)
    parser.add_argument(
        "--python", choices=NUMPY, default="3.11", help="3.11: Blender 4.2 to 5.0; 3.13: from 5.1"
    )
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wheels = fetch_wheels(Path(folder), asked.platform, asked.python)
        target = ROOT / "build" / f"meshsplatbench-blender-{asked.platform}-py{asked.python}.zip"
        build(target, wheels, asked.platform)
    print(f"{target}: {target.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
