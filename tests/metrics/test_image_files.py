"""Image files: supported formats, rejected files, and pairs of two folders."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb import metrics
from msb.errors import InputError, MetricError
from msb.metrics.pairs import pair_images
from msb.render.images import write_image
from tests.corpus.forge import png

PIXELS = np.random.default_rng(0).integers(0, 256, (6, 9, 3), dtype=np.uint8)


def encoded(form: str, pixels: Any = PIXELS, **options: Any) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, form, **options)
    return stream.getvalue()


def test_eight_bit_images_are_read_as_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "A.PNG"):
        (tmp_path / name).write_bytes(encoded("PNG"))
        assert np.array_equal(metrics.read_image(tmp_path / name), PIXELS)
    (tmp_path / "a.JPEG").write_bytes(encoded("JPEG"))
    assert metrics.read_image(tmp_path / "a.JPEG").dtype == np.uint8
    np.save(tmp_path / "b.npy", PIXELS)
    assert np.array_equal(metrics.read_image(tmp_path / "b.npy"), PIXELS)


@pytest.mark.parametrize("form", ["npy", "exr"])
def test_floats_are_read_as_msb_render_writes_them(tmp_path: Path, form: Any) -> None:
    frame = np.random.default_rng(1).normal(0.5, 1, (6, 9, 3)).astype(np.float32)
    write_image(tmp_path / f"a.{form}", frame, form)
    result = metrics.read_image(tmp_path / f"a.{form}")
    assert result.dtype == np.float32
    assert np.array_equal(result, frame)


def test_alpha_is_composited_over_the_background_in_floats(tmp_path: Path) -> None:
    alpha = np.full((6, 9, 1), 255, np.uint8)
    path = tmp_path / "a.png"
    path.write_bytes(encoded("PNG", np.concatenate([PIXELS, alpha], 2)))
    assert np.array_equal(metrics.read_image(path), PIXELS)
    alpha[2:, :4] = 51
    path.write_bytes(encoded("PNG", np.concatenate([PIXELS, alpha], 2)))
    with pytest.raises(MetricError, match=r"METRIC_IMAGE_ALPHA: .*30%"):
        metrics.read_image(path)
    result = metrics.read_image(path, background=(1, 0.5, 0))
    expected = PIXELS / 255 * (alpha / 255) + np.array([1, 0.5, 0]) * (1 - alpha / 255)
    assert np.allclose(result, expected, atol=1e-15)


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def plane_exr(folder: Path) -> bytes:
    write_image(folder / "plane.exr", np.zeros((4, 4), np.float32), "exr")
    return (folder / "plane.exr").read_bytes()


# tests/fuzz/bad_binaries.py has further cases.
BAD: dict[str, tuple[str, Any]] = {
    "grey jpeg": ("jpg", encoded("JPEG", PIXELS[..., 0])),
    "truncated": ("png", encoded("PNG")[:-40]),
    "too wide": ("png", png(70_000, 1)),
    "plane": ("npy", npy(np.zeros((4, 4)))),
    "exr noise": ("exr", b"noise" * 9),
    "exr plane": ("exr", plane_exr),
    "suffix": ("tif", b""),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_image_files_give_a_one_line_error(tmp_path: Path, name: str) -> None:
    suffix, content = BAD[name]
    path = tmp_path / f"image.{suffix}"
    path.write_bytes(content(tmp_path) if callable(content) else content)
    with pytest.raises(MetricError, match="METRIC_IMAGE") as caught:
        metrics.read_image(path)
    assert caught.value.file == str(path)
    assert len(str(caught.value).splitlines()) == 1


def folder(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"")
    return root


def test_images_are_paired_by_relative_name_without_suffix(tmp_path: Path) -> None:
    names = ("a.b.png", "a.c.exr", "sub/x.npy", "x.JPG", "x_depth.npy", ".hidden.png", "notes.txt")
    pred = folder(tmp_path / "pred", *names)
    gt = folder(tmp_path / "gt", "x.png", "sub/x.png", "a.c.png", "a.b.jpeg", ".git/y.png")
    pairs = pair_images(pred, gt)
    assert [pair.name for pair in pairs] == ["a.b", "a.c", "sub/x", "x"]
    assert pairs[2] == ("sub/x", pred / "sub/x.npy", gt / "sub/x.png")
    folder(gt, "more.png")
    with pytest.raises(MetricError, match=r"METRIC_IMAGE_NAMES: .*more"):
        pair_images(pred, gt)
    assert pair_images(pred, gt, subset=True) == pairs
    folder(pred, *(f"z{number}.png" for number in range(7)))
    with pytest.raises(MetricError, match=r"z4 and 2 more"):
        pair_images(pred, gt, subset=True)


def test_unpairable_images_are_rejected(tmp_path: Path) -> None:
    full, empty = folder(tmp_path / "full", "a.png"), folder(tmp_path / "empty", "a.txt")
    twice = folder(tmp_path / "twice", "a.png", "a.jpg")
    with pytest.raises(MetricError, match="METRIC_IMAGE_NAMES"):
        pair_images(full, empty)
    with pytest.raises(MetricError, match="METRIC_IMAGE_NAMES"):
        pair_images(full, twice)
    with pytest.raises(InputError, match="FILE_NOT_RECOGNISED"):
        pair_images(full, full / "a.png")
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        pair_images(full, tmp_path / "none")
    assert pair_images(full / "a.png", twice / "a.jpg") == [("a", full / "a.png", twice / "a.jpg")]
