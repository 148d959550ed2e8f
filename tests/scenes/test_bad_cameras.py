"""Files that are not valid: one error with the right code, soon, and without much memory."""

from __future__ import annotations

import contextlib
import random
import re
import sys
import time
import tracemalloc
from typing import TYPE_CHECKING, Any

import pytest

import msb
from msb.errors import CODES, InputError, MsbError, SceneError
from msb.scenes import read_points
from tests.conftest import ROOT

from .bad_cameras import BAD, SMALL
from .builders import write

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SECONDS = 5.0
"""Of processor time: far more than any file here takes, 16 MiB of JSON included."""
MUTATIONS = 400


def reader(name: str) -> Callable[[Path], Any]:
    return read_points if name.startswith("points") else msb.read_cameras


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    files, target, code, message = BAD[name]
    write(tmp_path, files)
    start = time.process_time()
    with pytest.raises(SceneError) as caught:
        reader(name)(tmp_path / target)
    assert time.process_time() - start < SECONDS
    error = caught.value
    assert error.code == code
    assert message in error.message
    assert str(error.file).startswith(str(tmp_path))
    assert str(error) == f"{code}: {error.file}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None


def test_there_are_many_cases() -> None:
    assert len(BAD) >= 150


NOT_OF_FILES = {"CAMERA_LOOK_AT", "CAMERA_PATH", "CAMERA_TOO_MANY"}


def test_every_code_has_a_bad_file_and_is_raised_somewhere() -> None:
    codes = {code for code, entry in CODES.items() if entry.kind is SceneError}
    codes = {code for code in codes if not code.startswith("SCENE_")}  # tests/scenes/datasets has those
    assert {bad[2] for bad in BAD.values()} == codes - NOT_OF_FILES
    text = "".join(path.read_text() for path in (ROOT / "msb" / "scenes").glob("*.py"))
    named = set(re.findall(r'"((?:CAMERA|COLMAP)_[A-Z0-9_]+[A-Z0-9])"', text))
    assert named == {code for code in codes if not code.startswith("CAMERA_JSON_")}


def test_a_model_of_too_many_images(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(tmp_path, SMALL["text"])
    monkeypatch.setattr("msb.scenes.colmap.MAX_CAMERAS", 1)
    with pytest.raises(SceneError, match=r"CAMERA_TOO_MANY: .*images.txt: line 5: there are more than 1 im"):
        msb.read_cameras(tmp_path)


@pytest.mark.parametrize(
    "name", [name for name in BAD if "huge" in name or "deep" in name or "absurd" in name]
)
def test_what_is_declared_takes_no_memory(name: str, tmp_path: Path) -> None:
    files, target, *_ = BAD[name]
    write(tmp_path, files)
    tracemalloc.start()
    try:
        with pytest.raises(SceneError):
            reader(name)(tmp_path / target)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * sum(map(len, files.values())) + (1 << 21)


def attempt(kind: str, folder: Path) -> None:
    """Read the folder; anything but a result or our own error fails the test."""
    start = time.process_time()
    with contextlib.suppress(MsbError):
        reader(kind)(folder)
    assert time.process_time() - start < SECONDS


@pytest.mark.parametrize("kind", SMALL)
def test_every_prefix(kind: str, tmp_path: Path) -> None:
    reader(kind)(write(tmp_path, SMALL[kind]))
    for name, content in SMALL[kind].items():
        for size in range(len(content)):
            (tmp_path / name).write_bytes(content[:size])
            attempt(kind, tmp_path)
        (tmp_path / name).write_bytes(content)


@pytest.mark.parametrize("kind", ["binary", "points3D.bin", "transforms.json", "cameras.json", "views.json"])
def test_no_prefix_of_these_is_taken_for_a_whole_file(kind: str, tmp_path: Path) -> None:
    for name, content in SMALL[kind].items():
        for size in range(len(content) - (name == "a.jpg") * 4):
            write(tmp_path, SMALL[kind] | {name: content[:size]})
            with pytest.raises(SceneError):
                reader(kind)(tmp_path)


@pytest.mark.parametrize("kind", SMALL)
def test_random_mutations(kind: str, tmp_path: Path) -> None:
    rng = random.Random(f"mutations of {kind}")
    write(tmp_path, SMALL[kind])
    for _ in range(MUTATIONS):
        name = rng.choice(list(SMALL[kind]))
        content = bytearray(SMALL[kind][name])
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(content) + 1)
            match rng.randrange(5):
                case 0:
                    content[at : at + 1] = bytes([rng.randrange(256)])
                case 1 if at < len(content):
                    content[at] ^= 1 << rng.randrange(8)
                case 2:
                    del content[at : at + rng.randint(1, 8)]
                case 3:
                    content[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\x7f\xf0" + b"\0" * 6])
                case _:
                    content[at:at] = rng.choice(
                        [b"9", b"-", b"\xff\xff\xff\xff", b" ", b"\n", b"nan", b"\0", b"e9", b"[", b'"', b","]
                    )
        (tmp_path / name).write_bytes(content)
        attempt(kind, tmp_path)
        (tmp_path / name).write_bytes(SMALL[kind][name])


def test_nothing_named_in_a_file_is_opened(tmp_path: Path) -> None:
    """Only files asked for, and images below the folder of a transforms.json that gives no size."""
    opened: list[str] = []
    active = True

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if active and event in ("open", "os.system", "subprocess.Popen", "exec", "import"):
            opened.append(str(arguments[0]))

    names = [name for name in BAD if any(word in name for word in (" up", "absolute", " nul", "surrogate"))]
    assert len(names) >= 8
    sys.addaudithook(watch)
    try:
        for index, name in enumerate(names):
            files, target, *_ = BAD[name]
            folder = write(tmp_path / str(index), files)
            opened.clear()
            with pytest.raises(SceneError):
                msb.read_cameras(folder / target)
            assert {*opened} <= {str(folder / file) for file in files}
    finally:
        active = False


@pytest.mark.skipif(sys.platform == "win32", reason="needs links and pipes")
def test_links_are_followed_but_pipes_are_not(tmp_path: Path) -> None:
    import os

    write(tmp_path / "real", SMALL["cameras.json"])
    (tmp_path / "linked").symlink_to(tmp_path / "real")
    assert len(msb.read_cameras(tmp_path / "linked" / "cameras.json")) == 1
    os.mkfifo(tmp_path / "cameras.json")
    with pytest.raises(InputError, match="FILE_UNREADABLE"):
        msb.read_cameras(tmp_path / "cameras.json")
    os.mkfifo(tmp_path / "images.bin")
    with pytest.raises(SceneError, match="CAMERA_SOURCE"):
        msb.read_cameras(tmp_path)
    write(tmp_path, {"transforms.json": SMALL["transforms.json"]["transforms.json"]})
    os.mkfifo(tmp_path / "a.jpg")
    with pytest.raises(SceneError, match="CAMERA_IMAGE"):
        msb.read_cameras(tmp_path)
