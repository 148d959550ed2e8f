"""Assets larger than memory maps to be afraid of: opened without reading or copying them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.corpus.forge import Entry, central_header, end64_records, end_record, local_header, padding, zip64
from tests.corpus.good import Parts, mesh, parts

pytestmark = pytest.mark.slow

FULL32 = 0xFFFFFFFF
GIB = 1 << 30


def large(vertices: int) -> Parts:
    """Return a mesh whose positions are said to be `vertices` rows; their bytes are not made."""
    good = parts(mesh())
    good.manifest["vertex_count"] = vertices
    spec = good.manifest["buffers"]["positions"]
    spec.update(shape=[vertices, 3], byte_length=12 * vertices)
    good.change("/buffers/color/shape", [vertices, 3]).change("/buffers/color/byte_length", 3 * vertices)
    del good.files["buffers/positions.bin"], good.files["buffers/color.bin"]
    return good


def skip_if_full(folder: Path) -> None:
    if shutil.disk_usage(folder).free < 7 * GIB:
        pytest.skip("less than 7 GiB free, which a file system without holes would need")


def write_sparse(path: Path, good: Parts) -> None:
    """Write a packed asset whose absent files are holes, with ZIP64 records where 32 bits do not do."""
    sizes = {spec["file"]: spec["byte_length"] for spec in good.manifest["buffers"].values()}
    central = b""
    with path.open("wb") as file:
        for name, size in {"manifest.json": len(good.text()), **sizes}.items():
            data = good.text() if name == "manifest.json" else good.files.get(name, b"")
            offset = file.tell()
            wide, far = size >= FULL32, offset >= FULL32
            fields = {"size": FULL32, "packed": FULL32} if wide else {"size": size, "packed": size}
            entry = Entry(name, data, both=fields)
            if wide:
                entry.local["extra"] = zip64(size, size) + padding(offset + 30 + len(name) + 20)
            header = local_header(entry, offset)
            values = ([size, size] if wide else []) + ([offset] if far else [])
            entry.central = {"offset": FULL32 if far else offset, "extra": zip64(*values) if values else b""}
            central += central_header(entry, offset)
            file.write(header + data)
            file.seek(size - len(data), os.SEEK_CUR)
        start = file.tell()
        numbers = {"disk": 0, "first_disk": 0, "here": 4, "count": 4, "length": len(central), "comment": b""}
        file.write(central)
        if start >= FULL32:
            file.write(
                end64_records({**numbers, "start": start, "record_size": 44, "at": file.tell(), "disks": 1})
            )
        file.write(end_record({**numbers, "start": min(start, FULL32)}))


def write_large(folder: Path, form: str, gib: float) -> Path:
    """Write an asset of `gib` GiB of holes and return its path."""
    good, path = large(int(gib * GIB / 15)), folder / "large.triasset"
    if form == "packed":
        write_sparse(path, good)
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
@pytest.mark.parametrize("gib", [2.2, 6.0])
def test_gigabytes_are_opened_without_reading_them(form: str, gib: float, tmp_path: Path) -> None:
    skip_if_full(tmp_path)
    path, small = write_large(tmp_path, form, gib), tmp_path / "small.triasset"
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
    assert result["bytes"] > gib * GIB
    assert result["last"] == [0.0, 0.0, 0.0, *mesh().buffers["indices"].ravel().tolist()]
    assert result["mib"] < 50
