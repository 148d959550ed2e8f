"""PLY files that are tables of primitives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from msb.errors import InputError, MeshFileError
from msb.meshes.ply_table import ply_names, read_ply_table

HEAD = "ply\nformat {} 1.0\nelement vertex 3\n"
HEAD += "property float a\nproperty double b\nproperty uchar c\nend_header\n"
ROWS = [(1.5, 2.5, 3), (-1.0, 1e300, 4), (0.25, 7.0, 255)]


def binary(order: str) -> bytes:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    row = np.dtype([("a", order + "f4"), ("b", order + "f8"), ("c", "u1")])
    return HEAD.format(name).encode() + np.array(ROWS, row).tobytes()


TEXT = HEAD.format("ascii").encode() + b"".join(b"%r %r %d\n" % row for row in ROWS)


@pytest.mark.parametrize("data", [binary("<"), binary(">"), TEXT], ids=["little", "big", "text"])
def test_columns_of_every_form(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "t.ply").write_bytes(data)
    assert ply_names(tmp_path / "t.ply") == (("a", "b", "c"), False)
    table = read_ply_table(tmp_path / "t.ply")
    assert (table.count, table.names) == (3, ("a", "b", "c"))
    found = table.columns(["c", "a"])
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, [[3, 1.5], [4, -1.0], [255, 0.25]])
    np.testing.assert_array_equal(table.columns(["b"]), [[2.5], [np.inf], [7.0]])


BAD = {
    "short": (binary("<")[:-1], "TRUNCATED"),
    "long": (binary("<") + b"x", "INVALID"),
    "text short": (TEXT[:-8], "INVALID"),
    "list": (TEXT.replace(b"uchar c", b"list uchar int c"), "INVALID"),
    "other element": (TEXT.replace(b"element vertex", b"element point"), "INVALID"),
    "huge": (binary("<").replace(b"x 3", b"x 999999999999999999"), "TRUNCATED"),
    "empty": (b"", "INVALID"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_tables(case: str, tmp_path: Path) -> None:
    data, code = BAD[case]
    (tmp_path / "t.ply").write_bytes(data)
    with pytest.raises(MeshFileError, match=f"MESH_FILE_{code}: {tmp_path / 't.ply'}: "):
        read_ply_table(tmp_path / "t.ply")
    with pytest.raises(InputError):
        read_ply_table(tmp_path / "none.ply")
