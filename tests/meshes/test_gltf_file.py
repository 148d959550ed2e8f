"""glTF as JSON: the same as a GLB, with buffers and images in its text or beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from msb.base.files import read_file
from msb.errors import MeshFileError
from msb.meshes import read_mesh

from .builders import SQUARE, SQUARE_FACES, TEXELS, Read, glb_textured, picture


def assert_square(path: Path) -> None:
    mesh = read_mesh(path)
    assert (mesh.vertices.tolist(), mesh.faces.tolist()) == (SQUARE, SQUARE_FACES)
    assert np.array_equal(mesh.textures[0], TEXELS)
    assert (mesh.up, mesh.left_out) == ("+y", ())


@pytest.mark.parametrize("uri", ["a.bin", "a%20folder/b.bin"])
def test_buffers_and_images_beside(tmp_path: Path, uri: str) -> None:
    made = glb_textured("a%20folder/map.png")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "a folder" / "map.png").write_bytes(picture())
    (tmp_path / uri.replace("%20", " ")).write_bytes(made.binary + b"more")
    (tmp_path / "a.gltf").write_bytes(made.text(uri))
    assert_square(tmp_path / "a.gltf")


def test_embedded_data_is_no_part_of_the_limit_of_the_text(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("msb.meshes.gltf.MAX_JSON_BYTES", 2000)
    path = tmp_path / "a.gltf"
    made = glb_textured()
    made.view(bytes(6000))
    path.write_bytes(made.text())
    assert path.stat().st_size > 8000
    assert_square(path)


def test_a_file_that_several_buffers_name_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(
        "msb.meshes.beside.read_file", lambda path, most: (opened.append(path), read_file(path, most))[1]
    )
    made = glb_textured()
    whole = made.root["buffers"][0]["byteLength"]
    made.root["buffers"] += [{"uri": "./a.bin", "byteLength": whole}, {"uri": "%61.bin", "byteLength": 40}]
    made.root["bufferViews"][1]["buffer"] = 1
    path = tmp_path / "a.gltf"
    (tmp_path / "a.bin").write_bytes(made.binary)
    path.write_bytes(made.text("a.bin"))
    assert_square(path)
    assert opened == [tmp_path.resolve() / "a.bin"]
    made.root["bufferViews"][0]["buffer"] = 2
    path.write_bytes(made.text("a.bin"))
    with pytest.raises(MeshFileError, match="MESH_FILE_TRUNCATED"):
        read_mesh(path)


def test_several_buffers(read: Read) -> None:
    made = glb_textured()
    made.root["buffers"].append({"byteLength": 48, "uri": "data:;base64," + "AAAA" * 16})
    made.root["bufferViews"][0] |= {"buffer": 1}
    assert not np.any(read(made.text(), ".gltf").vertices)
    assert not np.any(read(made.bytes(), ".glb").vertices)
