"""Sizes from headers are those a real image library finds."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from msb.errors import MsbError, SceneError
from msb.scenes import image_size

from .builders import jpeg, png


def size_of(content: bytes, folder: Path) -> tuple[int, int]:
    (folder / "image").write_bytes(content)
    return image_size(folder / "image")


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (640, 480)])
def test_sizes_of_our_own_files(size: tuple[int, int], tmp_path: Path) -> None:
    assert size_of(png(*size), tmp_path) == size
    assert size_of(jpeg(*size), tmp_path) == size


@pytest.mark.parametrize(
    ("kind", "mode", "options"),
    [
        ("PNG", "RGBA", {}),
        ("PNG", "I;16", {}),
        ("PNG", "P", {}),
        ("JPEG", "RGB", {}),
        ("JPEG", "L", {"quality": 5}),
        ("JPEG", "CMYK", {}),
        ("JPEG", "RGB", {"progressive": True, "comment": b"\xff\xc0 not a frame"}),
        (
            "JPEG",
            "RGB",
            {"exif": b"Exif\0\0" + bytes(60_000), "icc_profile": bytes(150_000), "dpi": (72, 72)},
        ),
    ],
)
def test_sizes_of_what_pillow_writes(
    kind: str, mode: str, options: dict[str, object], tmp_path: Path
) -> None:
    image = pytest.importorskip("PIL.Image")
    for size in ((7, 5), (123, 45)):
        stream = io.BytesIO()
        image.new(mode, size).save(stream, kind, **options)
        assert size_of(stream.getvalue(), tmp_path) == size
        with image.open(tmp_path / "image") as opened:
            assert opened.size == size


@pytest.mark.parametrize("frame", [0xC1, 0xC2, 0xC3, 0xC5, 0xC9, 0xCF])
def test_all_kinds_of_jpeg_frames(frame: int, tmp_path: Path) -> None:
    fill = b"\xff\xff\xff\xfe\0\4ab" + b"\xff\xc4\0\5\xff\xc0\1" + b"\xff\xcc\0\2"
    assert size_of(jpeg(6, 8, frame=frame, before=fill), tmp_path) == (6, 8)


BAD = {
    "empty": (b"", "CAMERA_IMAGE"),
    "gif": (b"GIF89a\1\0\1\0" + bytes(40), "CAMERA_IMAGE"),
    "half a png": (png(4, 4)[:20], "CAMERA_IMAGE"),
    "png of another kind": (png(4, 4).replace(b"IHDR", b"CgBI"), "CAMERA_IMAGE"),
    "flat png": (png(4, 4)[:16] + bytes(4) + png(4, 4)[20:], "CAMERA_SIZE"),
    "huge png": (png(4, 4)[:16] + b"\x7f\xff\xff\xff" * 2, "CAMERA_SIZE"),
    "wide png": (png(4, 4)[:16] + b"\0\1\0\0\0\0\0\1", "CAMERA_SIZE"),
    "half a jpeg": (jpeg(4, 4)[:-11], "CAMERA_IMAGE"),
    "jpeg without lines": (jpeg(4, 0), "CAMERA_SIZE"),
    "jpeg without a frame": (jpeg(4, 4)[:20] + b"\xff\xda\0\4ab" + jpeg(4, 4)[20:], "CAMERA_IMAGE"),
    "jpeg with rubbish": (jpeg(4, 4)[:20] + b"rubbish", "CAMERA_IMAGE"),
    "endless fill": (b"\xff\xd8" + b"\xff" * 1_000_000, "CAMERA_IMAGE"),
    "endless segments": (b"\xff\xd8" + b"\xff\xe1\0\2" * 300_000, "CAMERA_IMAGE"),
    "segments of no length": (b"\xff\xd8" + b"\xff\xe1\0\0" * 10, "CAMERA_IMAGE"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_image_is_refused(name: str, tmp_path: Path) -> None:
    content, code = BAD[name]
    with pytest.raises(MsbError) as caught:
        size_of(content, tmp_path)
    assert caught.value.code == code
    assert caught.value.file == str(tmp_path / "image")


def test_every_prefix_of_an_image(tmp_path: Path) -> None:
    for content in (png(3, 3), jpeg(3, 3)):
        for end in range(len(content)):
            with contextlib.suppress(SceneError):
                assert size_of(content[:end], tmp_path) == (3, 3)


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    for path, code in ((tmp_path, "FILE_UNREADABLE"), (tmp_path / "absent.png", "FILE_NOT_FOUND")):
        with pytest.raises(MsbError) as caught:
            image_size(path)
        assert caught.value.code == code
