"""COLMAP models: lens models, special cases of the text format, and points."""

from pathlib import Path

import numpy as np
import pytest

import msb
from msb.scenes import colmap_binary, read_points
from msb.scenes.colmap import find_model
from msb.scenes.colmap_models import MODEL_NAMES, MODELS

from .builders import lens_bin, lens_parameters, many, point_bin, shot_bin, write

PINHOLES = [name for name in MODELS if "FISHEYE" not in name and name != "EUCM"]


def test_the_models_have_the_ids_and_parameters_of_colmap() -> None:
    counts = [3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6]
    assert [MODELS[MODEL_NAMES[number]].parameters for number in range(17)] == counts


@pytest.mark.parametrize("model", PINHOLES)
@pytest.mark.parametrize("form", ["bin", "txt"])
def test_models_without_distortion_are_pinhole_cameras(model: str, form: str, tmp_path: Path) -> None:
    parameters = lens_parameters(model, 0)
    if form == "bin":
        files = {
            "cameras.bin": many(lens_bin(1, MODELS[model].number, parameters=parameters)),
            "images.bin": many(shot_bin()),
        }
    else:
        files = {
            "cameras.txt": f"1 {model} 40 30 {' '.join(map(str, parameters))}".encode(),
            "images.txt": b"1 1 0 0 0 0 0 0 1 a.png",
        }
    (camera,) = msb.read_cameras(write(tmp_path, files))
    fy = 50.0 if MODELS[model].focals == 1 else 49.0
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50.0, fy, 20.0, 15.0)
    assert (camera.width, camera.height, camera.name) == (40, 30, "a.png")
    assert camera.distortion is None


@pytest.mark.parametrize("model", [name for name, model in MODELS.items() if model.distortions])
def test_distortion_is_read_with_the_pinhole_part(model: str, tmp_path: Path) -> None:
    parameters = lens_parameters(model, 0.01)
    lenses = many(lens_bin(1, MODELS[model].number, parameters=parameters))
    (camera,) = msb.read_cameras(write(tmp_path, {"cameras.bin": lenses, "images.bin": many(shot_bin())}))
    assert camera.distortion is not None
    assert camera.distortion.model == model
    assert camera.distortion.coefficients == (0.01,) * MODELS[model].distortions
    assert (camera.fx, camera.cx) == (50.0, 20.0)


def test_of_several_models_the_largest_is_read(tmp_path: Path) -> None:
    def model(count: int) -> dict[str, bytes]:
        shots = (shot_bin(i, name=f"{i}.png\0".encode()) for i in range(count))
        return {"cameras.bin": many(lens_bin()), "images.bin": many(*shots)}

    for folder, count in (("0", 2), ("1", 5), ("2", 5)):
        write(tmp_path / "sparse" / folder, model(count))
    assert find_model(tmp_path) == tmp_path / "sparse/1"
    cameras = msb.read_cameras(tmp_path)
    assert len(cameras) == 5
    assert cameras[0].image_path == tmp_path / "images/0.png"
    text = b"# list\n" + b"".join(b"%d 1 0 0 0 0 0 0 1 %d.png\n\n" % (i, i) for i in range(6))
    write(tmp_path / "sparse/2", {"images.txt": text})
    (tmp_path / "sparse/2/images.bin").unlink()
    assert find_model(tmp_path) == tmp_path / "sparse/2"


def test_an_unused_distorted_camera_is_ignored(tmp_path: Path) -> None:
    distorted = lens_bin(2, 4, parameters=lens_parameters("OPENCV", 0.1))
    files = {"cameras.bin": many(distorted, lens_bin()), "images.bin": many(shot_bin())}
    assert len(msb.read_cameras(write(tmp_path, files))) == 1


TEXT_LENS = b"# Camera list\n\n7 PINHOLE 40 30 50 49 20 15\n"


def images(*lines: bytes) -> dict[str, bytes]:
    return {"cameras.txt": TEXT_LENS, "images.txt": b"\n".join(lines)}


def test_an_empty_line_of_2d_points_belongs_to_its_image(tmp_path: Path) -> None:
    files = images(
        b"# Image list",
        b"1 1 0 0 0 0 0 0 7 a.png",
        b"",
        b"2 1 0 0 0 1 0 0 7 b.png",
        b"1 2 3 4 5 6",
        b"3 1 0 0 0 2 0 0 7 c.png",
        b"   ",
        b"",  # blank lines between images are harmless
        b"4 1 0 0 0 3 0 0 7 d.png",
    )  # the file may end directly after the line of an image
    cameras = msb.read_cameras(write(tmp_path, files))
    assert [(camera.name, camera.world_to_camera[0, 3]) for camera in cameras] == [
        ("a.png", 0), ("b.png", 1), ("c.png", 2), ("d.png", 3)
    ]  # fmt: skip


def test_a_line_of_2d_points_may_look_like_a_comment_or_an_image(tmp_path: Path) -> None:
    files = images(
        b"1 1 0 0 0 0 0 0 7 a.png",
        b"1 1 0 0 0 0 0 0 7 5 5 5",
        b"2 1 0 0 0 0 0 0 7 b.png",
        b"# no comment",
        b"3 1 0 0 0 0 0 0 7 c.png",
    )
    assert [c.name for c in msb.read_cameras(write(tmp_path, files))] == ["a.png", "b.png", "c.png"]


def test_names_hold_spaces_and_other_scripts(tmp_path: Path) -> None:
    name = "my photos/\u5ead\u5712 1.JPG"
    files = images(b"1 1 0 0 0 0 0 0 7 " + name.encode() + b"\r", b"\r")
    assert msb.read_cameras(write(tmp_path / "txt", files))[0].name == name
    files = {
        "cameras.bin": many(lens_bin()),
        "images.bin": many(shot_bin(name=name.encode() + b"\0", points=3)),
    }
    assert msb.read_cameras(write(tmp_path / "bin", files))[0].name == name


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    files = {name: b"\xef\xbb\xbf" + text for name, text in images(b"1 1 0 0 0 0 0 0 7 a.png").items()}
    assert len(msb.read_cameras(write(tmp_path, files))) == 1


# --- points


def text_points(xyz: np.ndarray, rgb: np.ndarray, tracks: list[int]) -> bytes:
    lines = ["# 3D point list"]
    for index, (place, color, track) in enumerate(zip(xyz.tolist(), rgb.tolist(), tracks, strict=True)):
        words = [index, *map(repr, place), *color, 0.25, *[3, 4] * track]
        lines.append(" ".join(map(str, words)))
    return "\n".join([*lines, ""]).encode()


def test_points_are_read_from_both_forms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(colmap_binary, "_POINTS_AT_A_TIME", 7)
    rng = np.random.default_rng(1)
    for count in (0, 1, 6, 7, 8, 100):
        xyz = rng.normal(size=(count, 3)) * 10.0 ** rng.integers(-5, 5, size=(count, 1))
        rgb = rng.integers(0, 256, size=(count, 3), dtype=np.uint8)
        tracks = rng.integers(0, 5, size=count).tolist()
        records = [point_bin(i, xyz[i], rgb[i], tracks[i]) for i in range(count)]
        files = {"points3D.bin": many(*records), "points3D.txt": text_points(xyz, rgb, tracks)}
        write(tmp_path / "sparse" / "0", files)
        for path in ("sparse/0/points3D.bin", "sparse/0/points3D.txt", "sparse/0", ""):
            points, colors = read_points(tmp_path / path)
            assert points.dtype == np.float64
            assert colors.dtype == np.uint8
            np.testing.assert_array_equal(points, xyz)
            np.testing.assert_array_equal(colors, rgb)


def test_numbers_of_text_points_may_have_signs_and_exponents(tmp_path: Path) -> None:
    (tmp_path / "points3D.txt").write_bytes(b"1 +1 -2e0 .5 0 255 12.0 0.1 1 2\r\n\n# x\n 2 0 0 0 1 2 3 9")
    xyz, rgb = read_points(tmp_path / "points3D.txt")
    assert xyz.tolist() == [[1, -2, 0.5], [0, 0, 0]]
    assert rgb.tolist() == [[0, 255, 12], [1, 2, 3]]
