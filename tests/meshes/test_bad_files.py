"""Files that are not valid: one error with the right code, soon, and without much memory."""

from __future__ import annotations

import contextlib
import random
import sys
import time
import tracemalloc
from typing import TYPE_CHECKING

import pytest

from msb.errors import CODES, MeshFileError, MsbError
from msb.meshes import read_mesh

from .bad_files import BAD
from .builders import SMALL

if TYPE_CHECKING:
    from pathlib import Path

SECONDS = 2.0
"""Of processor time: far more than a small file takes."""

MUTATIONS = 300


@pytest.fixture(autouse=True, scope="module")
def _library_of_binary_stl_is_loaded(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Import, before any time is taken, what the reader of binary STL imports when it is first used."""
    path = tmp_path_factory.mktemp("warm") / "mesh.stl"
    path.write_bytes(SMALL[".stl"])
    read_mesh(path)


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    suffix, content, code, message = BAD[name]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    start = time.process_time()
    with pytest.raises(MeshFileError) as caught:
        read_mesh(path)
    assert time.process_time() - start < SECONDS
    error = caught.value
    assert error.code == code
    assert message in error.message
    assert error.file == str(path)
    assert str(error) == f"{code}: {path}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None


def test_every_code_of_mesh_files_has_a_bad_file() -> None:
    codes = {code for code, entry in CODES.items() if entry.kind is MeshFileError}
    assert {bad[2] for bad in BAD.values()} == codes


@pytest.mark.parametrize(
    "name",
    [name for name in BAD if any(word in name for word in ("huge", "deep", "times", "endless", "zero-size"))],
)
def test_what_is_declared_takes_no_memory(name: str, tmp_path: Path) -> None:
    suffix, content, *_ = BAD[name]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(MeshFileError):
            read_mesh(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20 * len(content) + (1 << 22)


def attempt(path: Path, content: bytes) -> None:
    """Read `content`; anything but a mesh or our own error fails the test."""
    path.write_bytes(content)
    start = time.process_time()
    with contextlib.suppress(MsbError):
        read_mesh(path)
    assert time.process_time() - start < SECONDS


def test_a_glb_of_too_many_nodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("msb.meshes.gltf_nodes.MAX_NODES", 0)
    (tmp_path / "nodes.glb").write_bytes(SMALL[".glb"])
    with pytest.raises(MeshFileError, match=r"MESH_FILE_TOO_LARGE: .*there are 1 nodes, more than 0"):
        read_mesh(tmp_path / "nodes.glb")


@pytest.mark.parametrize("suffix", SMALL)
def test_every_prefix(suffix: str, tmp_path: Path) -> None:
    content = SMALL[suffix]
    for size in range(len(content)):
        attempt(tmp_path / f"prefix{suffix}", content[:size])


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb"])
def test_no_prefix_of_a_binary_file_is_taken_for_a_whole_one(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"prefix{suffix}"
    for size in range(len(SMALL[suffix])):
        path.write_bytes(SMALL[suffix][:size])
        with pytest.raises(MeshFileError):
            read_mesh(path)


@pytest.mark.parametrize("suffix", SMALL)
def test_random_mutations(suffix: str, tmp_path: Path) -> None:
    rng = random.Random(f"mutations of {suffix}")
    for _ in range(MUTATIONS):
        content = bytearray(SMALL[suffix])
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(content))
            match rng.randrange(4):
                case 0:
                    content[at] = rng.randrange(256)
                case 1:
                    content[at] ^= 1 << rng.randrange(8)
                case 2:
                    del content[at : at + rng.randint(1, 8)]
                case 3:
                    content[at:at] = rng.choice(
                        [b"9", b"-", b"\xff\xff\xff\xff", b" ", b"\n", b"nan", b"\0", b"1e9"]
                    )
            if not content:
                break
        attempt(tmp_path / f"mutation{suffix}", bytes(content))


def test_nothing_named_in_a_file_is_opened_or_run(tmp_path: Path) -> None:
    opened: list[object] = []
    active = True

    def watch(event: str, arguments: tuple[object, ...]) -> None:
        by_name = bool(arguments) and not isinstance(arguments[0], int)  # a number: what was opened before
        if active and by_name and event in ("open", "os.system", "subprocess.Popen", "exec", "import"):
            opened.append((event, arguments[0]))

    sys.addaudithook(watch)
    try:
        names = ["obj: call", "obj: shell", "glb: external buffer"]
        for name in names:
            suffix, content, *_ = BAD[name]
            (tmp_path / f"bad{suffix}").write_bytes(content)
            opened.clear()
            with pytest.raises(MeshFileError):
                read_mesh(tmp_path / f"bad{suffix}")
            assert opened == [("open", str(tmp_path / f"bad{suffix}"))]
        (tmp_path / "material.obj").write_bytes(b"mtllib secret.mtl\nv 0 0 0\nusemtl a\n")
        opened.clear()
        assert len(read_mesh(tmp_path / "material.obj").vertices) == 1
        assert opened == [("open", str(tmp_path / "material.obj"))]
    finally:
        active = False
