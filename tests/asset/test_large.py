"""Assets of several GiB are opened without reading or copying them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.corpus.forge import FULL32, Entry, padding, write_sparse, zip64
from tests.corpus.good import Parts, mesh, parts

pytestmark = pytest.mark.slow

GIB = 1 << 30


def large(vertices: int) -> Parts:
    """Return a mesh that declares as many positions as `vertices`, but without their bytes."""
    good = parts(mesh())
    good.manifest["vertex_count"] = vertices
    spec = good.manifest["buffers"]["positions"]
    spec.update(shape=[vertices, 3], byte_length=12 * vertices)
    good.change("/buffers/color/shape", [vertices, 3]).change("/buffers/color/byte_length", 3 * vertices)
    del good.files["buffers/positions.bin"], good.files["buffers/color.bin"]
    return good


def entry(name: str, data: bytes, size: int, at: int) -> Entry:
    """Return a member with ZIP64 records for values of more than 32 bits."""
    short = min(size, FULL32)
    member = Entry(name, data, both={"size": short, "packed": short})
    wide = [size, size] if size >= FULL32 else []
    if wide:
        member.local["extra"] = zip64(*wide) + padding(at + 30 + len(name) + 20)
    values = wide + ([at] if at >= FULL32 else [])
    member.central = {"offset": min(at, FULL32), "extra": zip64(*values) if values else b""}
    return member


def write_large(folder: Path, form: str) -> Path:
    """Write a sparse asset of 6 GiB and return its path."""
    good, path = large(6 * GIB // 15), folder / "large.triasset"
    if form == "packed":
        sizes = {spec["file"]: spec["byte_length"] for spec in good.manifest["buffers"].values()}
        files = {name: good.files.get(name, b"") for name in sizes}
        holes = [(name, data, sizes[name] - len(data)) for name, data in files.items()]
        write_sparse(path, [("manifest.json", good.text(), 0), *holes], entry)
    else:
        good.write_folder(path)
        for name in ("positions", "color"):
            (path / f"buffers/{name}.bin").touch()
            os.truncate(path / f"buffers/{name}.bin", good.manifest["buffers"][name]["byte_length"])
    return path


OPEN = """
import json, sys
from pathlib import Path
import msb
from msb.asset import load
from fuzz.guard import peak_mib
load(sys.argv[1])
status = Path("/proc/self/status")
before = peak_mib(status.read_text().splitlines())
asset = load(sys.argv[2])
last = asset.buffers["positions"][-1].tolist() + asset.buffers["indices"].ravel().tolist()
after = peak_mib(status.read_text().splitlines())
total = sum(array.nbytes for array in asset.buffers.values())
print(json.dumps({"bytes": total, "last": last, "mib": after - before}))
"""


@pytest.mark.parametrize("form", ["packed", "folder"])
def test_gigabytes_are_opened_without_reading_them(form: str, tmp_path: Path) -> None:
    if shutil.disk_usage(tmp_path).free < 7 * GIB:
        pytest.skip("less than 7 GiB free; a file system without sparse files would need them")
    path, small = write_large(tmp_path, form), tmp_path / "small.triasset"
    parts(mesh()).write_packed(small)
    done = subprocess.run(
        [sys.executable, "-c", OPEN, small, path],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        cwd=Path(__file__).parents[2],
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["bytes"] >= 6 * GIB
    assert result["last"] == [0.0, 0.0, 0.0, *mesh().buffers["indices"].ravel().tolist()]
    assert result["mib"] < 50
