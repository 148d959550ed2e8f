"""Frames as files, read back by independent libraries."""

import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.errors import OutputError, UsageError
from msb.render.images import Writers, image_names, to_bytes, write_film, write_image
from msb.scenes import Camera

RANDOM = np.random.default_rng(0)
IMAGE = (RANDOM.random((31, 46, 3)) * 1.4 - 0.2).astype(np.float32)


def test_bytes_are_rounded_half_up_as_the_specs_state() -> None:
    levels = np.arange(256, dtype=np.float32) / np.float32(255)
    np.testing.assert_array_equal(to_bytes(levels), np.arange(256))
    # Half a level is always rounded up. With round-half-even, every second half would be rounded down.
    halves = ((np.arange(255) + 0.5) / 255).astype(np.float32)
    expected = np.floor(halves * np.float32(255) + np.float32(0.5)).astype(np.uint8)
    np.testing.assert_array_equal(to_bytes(halves), expected)
    assert np.count_nonzero(to_bytes(halves) == np.arange(1, 256)) > 200
    np.testing.assert_array_equal(to_bytes(np.array([-1, 0, 1, 7, np.nan, np.inf])), [0, 0, 255, 255, 0, 255])


def test_png_npy_and_exr(tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    for form in ("png", "npy", "exr"):
        write_image(tmp_path / f"a.{form}", IMAGE, form)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB"
        np.testing.assert_array_equal(np.asarray(image), to_bytes(IMAGE))
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy", allow_pickle=False), IMAGE)
    with openexr.File(str(tmp_path / "a.exr")) as file:
        np.testing.assert_array_equal(file.channels()["RGB"].pixels, IMAGE)
    write_image(tmp_path / "depth.exr", IMAGE[:, :, 0], "exr")
    with openexr.File(str(tmp_path / "depth.exr")) as file:
        np.testing.assert_array_equal(file.channels()["Z"].pixels, IMAGE[:, :, 0])
    ids = RANDOM.integers(-1, 1 << 30, (5, 7)).astype(np.int32)
    write_image(tmp_path / "ids.exr", ids, "exr")
    with openexr.File(str(tmp_path / "ids.exr")) as file:
        np.testing.assert_array_equal(file.channels()["id"].pixels.astype(np.int32), ids)
    write_image(tmp_path / "ids.npy", ids, "npy")
    np.testing.assert_array_equal(np.load(tmp_path / "ids.npy"), ids)
    with pytest.raises(UsageError, match="USAGE"):
        write_image(tmp_path / "depth.png", IMAGE[:, :, 0], "png")
    assert not (tmp_path / "depth.png").exists()


Y, X = np.mgrid[0:95, 0:128] / np.float32(128)
SMOOTH = np.stack([X, Y, 0.5 * X + 0.2], axis=2, dtype=np.float32)


def test_a_film_contains_every_frame(tmp_path: Path) -> None:
    for suffix in ("mp4", "gif"):
        write_film(tmp_path / f"f.{suffix}", (np.roll(SMOOTH, 4 * i, axis=1) for i in range(7)), 10)
    with Image.open(tmp_path / "f.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"]) == (7, (128, 95), 100)
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "f.mp4")) as film:
        decoded = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == 10
    assert [frame.shape for frame in decoded] == [(94, 128, 3)] * 7  # H.264 films have even sizes
    assert np.abs(decoded[0].astype(int) - to_bytes(SMOOTH[:94])).mean() < 3


def test_a_film_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def frames():
        yield IMAGE
        raise OutputError("OUTPUT_UNWRITABLE", "the renderer failed")

    with pytest.raises(OutputError):
        write_film(tmp_path / "f.mp4", frames(), 24)
    assert list(tmp_path.iterdir()) == []
    pytest.importorskip("av")
    with pytest.raises(UsageError, match="USAGE"):
        write_film(tmp_path / "f.mp4", [IMAGE[:1]], 24)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="USAGE"):
        write_film(tmp_path / "f.avi", [IMAGE], 24)


def test_names_of_views_are_unique() -> None:
    def names(*given: str | None) -> list[str]:
        return image_names([Camera(4, 4, 1, 1, 2, 2, np.eye(4), name) for name in given])

    assert names("a.png", "b/c.jpg", None) == ["a", "b/c", "00002"]
    assert names("a.png", "a.jpg") == ["a.png", "a.jpg"]
    assert names("a.png", "a.png") == ["a_00000", "a_00001"]
    assert names("a.png", "a.jpg", "a.png.png") == ["a.png_00000", "a.jpg", "a.png_00002"]


def test_writers_run_in_the_background_and_report_failures(tmp_path: Path) -> None:
    calls: list[tuple[int, threading.Thread]] = []  # appending is atomic

    def note(number: int) -> None:
        calls.append((number, threading.current_thread()))

    with Writers() as writers:
        for number in range(20):
            writers.submit(note, number)
    assert sorted(number for number, _ in calls) == list(range(20))
    assert threading.main_thread() not in {thread for _, thread in calls}

    def fail() -> None:
        raise OutputError("OUTPUT_UNWRITABLE", "the disk is full")

    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"), Writers() as writers:
        writers.submit(fail)
    writers = Writers()
    writers.submit(fail)
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
        [writers.submit(note, 1) for _ in range(50)]
