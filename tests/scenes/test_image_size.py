"""Sizes of photographs from their headers, and files without a valid header."""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from msb.errors import SceneError
from msb.scenes import image_size
from msb.scenes.image_size import read_header

from .builders import jpeg, png


def write_image(content: bytes, folder: Path) -> Path:
    (folder / "image").write_bytes(content)
    return folder / "image"


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (640, 480)])
@pytest.mark.parametrize("build", [png, jpeg, lambda *size: jpeg(*size, frame=0xC2)])
def test_the_size_is_that_of_the_header(
    build: Callable[..., bytes], size: tuple[int, int], tmp_path: Path
) -> None:
    assert image_size(write_image(build(*size), tmp_path)) == size


def test_an_orientation_is_not_applied(tmp_path: Path) -> None:
    exif, stream = Image.Exif(), io.BytesIO()
    exif[0x0112] = 6
    Image.new("RGB", (7, 5)).save(stream, "JPEG", exif=exif, icc_profile=bytes(150_000))
    header = read_header(write_image(stream.getvalue(), tmp_path))
    assert (header.size, header.orientation, header.format) == ((7, 5), 6, "JPEG")


@pytest.mark.parametrize("kind", ["WEBP", "TIFF", "AVIF"])
def test_other_formats(kind: str, tmp_path: Path) -> None:
    stream = io.BytesIO()
    try:
        Image.new("RGB", (7, 5)).save(stream, kind)
    except (KeyError, OSError):
        pytest.skip(f"this Pillow does not write {kind}")
    assert read_header(write_image(stream.getvalue(), tmp_path)).size == (7, 5)


@pytest.mark.parametrize(("mode", "alpha"), [("RGBA", True), ("LA", True), ("RGB", False)])
def test_alpha_is_a_channel(mode: str, alpha: bool, tmp_path: Path) -> None:
    stream = io.BytesIO()
    Image.new(mode, (2, 2)).save(stream, "PNG", **({} if alpha else {"transparency": (0, 0, 0)}))
    assert read_header(write_image(stream.getvalue(), tmp_path)).has_alpha is alpha


BAD = {
    "gif": b"GIF89a\1\0\1\0" + bytes(40),
    "png of another kind": png(4, 4).replace(b"IHDR", b"CgBI"),
    "wide png": png(65536, 1),
    "bomb": png(1, 1).replace(b"IHDR\0\0\0\1\0\0\0\1", b"IHDR\0\0\x7f\xff\0\0\x7f\xff"),
    "half a jpeg": jpeg(4, 4)[:-11],
    "jpeg without lines": jpeg(4, 0),
    "endless fill": b"\xff\xd8" + b"\xff" * 1_000_000,
    "endless segments": b"\xff\xd8" + b"\xff\xe1\0\2" * 300_000,
}


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_not_images_are_rejected(name: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        image_size(write_image(BAD[name], tmp_path))
    assert caught.value.code == ("CAMERA_INVALID" if name == "wide png" else "CAMERA_IMAGE")
    assert caught.value.file == str(tmp_path / "image")


@pytest.mark.parametrize(("segments", "valid"), [(100, True), (130, False)])
def test_the_header_must_be_in_the_first_8_mib(segments: int, valid: bool, tmp_path: Path) -> None:
    content = jpeg(4, 4, before=(b"\xff\xe1\xff\xff" + bytes(65533)) * segments)
    with contextlib.nullcontext() if valid else pytest.raises(SceneError, match="CAMERA_IMAGE"):
        assert image_size(write_image(content, tmp_path)) == (4, 4)


def test_every_prefix_of_an_image(tmp_path: Path) -> None:
    for content in (png(3, 3), jpeg(3, 3)):
        for end in range(len(content)):
            with contextlib.suppress(SceneError):
                assert image_size(write_image(content[:end], tmp_path)) == (3, 3)
