"""A face that uses a vertex which is not there: its line is named where the file has lines."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import msb
from msb.errors import MeshError
from msb.meshes import read_mesh

HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
POINTS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
WRITTEN = {
    "a.obj": (
        "# a quad first, then\\\n a comment\n"
        + "v 0 0 0\n" * 4
        + "f 1 2 3 4\n\nl 1 9\nf 1 9\nf 2/1 3/1 9/1\n",
        "line 11: .* 9; .* 1 to 4",
    ),
    "empty.obj": (
        "v 0 0 0\nf 1 2 3\n",
        "line 2: .* 2; .* 1 to 1",
    ),
    "a.off": (
        f"OFF\n# counts\n4 2 0\n{POINTS}4 0 1 2 3\n\n3 0 1 4 255 0 0\n",
        "line 10: .* 4; .* 0 to 3",
    ),
    "negative.off": (
        f"OFF 4 1 0\n{POINTS}3 0 -1 2\n",
        "line 6: .* -1; .* 0 to 3",
    ),
    "a.ply": (
        f"{HEADER}{POINTS}4 0 1 2 3\n3 0 1 7\n",
        "line 15: .* 7; .* 0 to 3",
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_every_way_to_use_the_file_names_the_line(name: str, tmp_path: Path) -> None:
    content, pattern = WRITTEN[name]
    path = tmp_path / name
    path.write_text(content)
    text = read_mesh(path).wrong_face
    assert re.match(pattern, text)
    for use in (msb.audit, msb.open, lambda path: msb.validate(path).findings[0].to_error(path)):
        try:
            found = use(path)
        except MeshError as error:
            found = error
        assert str(found) == f"MESH_INDEX_OUT_OF_RANGE: {path}: {text}"


def test_bytes_have_no_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    header = HEADER.replace("ascii", "binary_little_endian")
    path.write_bytes(header.encode() + bytes(48) + (b"\3" + bytes(8) + b"\7\0\0\0") * 2)
    assert read_mesh(path).wrong_face is None
    with pytest.raises(MeshError, match="INDEX_OUT_OF_RANGE"):
        msb.audit(path)
