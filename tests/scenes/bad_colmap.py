"""COLMAP models and points that must be refused; see bad_cameras.py."""

from __future__ import annotations

import math
from typing import Any

from msb.scenes.colmap_models import MODELS

from .builders import Bad, lens_bin, lens_parameters, many, point_bin, shot_bin

LENSES, SHOTS = many(lens_bin()), many(shot_bin())
TEXT = {"cameras.txt": b"1 PINHOLE 40 30 50 49 20 15\n", "images.txt": b"5 1 0 0 0 0 0 0 1 a.png\n1 2 -1\n"}


def colmap(message: str, cameras: bytes = LENSES, images: bytes = SHOTS, code: str = "COLMAP_INVALID") -> Bad:
    return {"cameras.bin": cameras, "images.bin": images}, "", code, message


def with_lens(message: str, *values: Any, code: str = "COLMAP_INVALID", **more: Any) -> Bad:
    return colmap(message, many(lens_bin(*values, **more)), code=code)


def with_shot(message: str, *values: Any, code: str = "COLMAP_INVALID", **more: Any) -> Bad:
    return colmap(message, images=many(shot_bin(*values, **more)), code=code)


def text(message: str, code: str = "COLMAP_INVALID", **change: bytes) -> Bad:
    return {**TEXT, **{f"{key}.txt": value for key, value in change.items()}}, "", code, message


def lens_line(parameters: bytes, head: bytes = b"1 PINHOLE 40 30 ") -> bytes:
    return b"# Camera list\n" + head + parameters + b"\n"


BAD_COLMAP: dict[str, Bad] = {
    "empty cameras": colmap("byte 0: the file ends within the number", b""),
    "empty images": colmap("the number of records, 8 bytes too early", images=b""),
    "huge count of cameras": colmap(
        "18446744073709551615 cameras of at least 24 bytes", many(count=2**64 - 1)
    ),
    "one camera more declared": colmap("byte 64: the file ends within camera 1", many(lens_bin(), count=2)),
    "camera trailing": colmap("byte 64: 4 bytes follow", LENSES + b"more"),
    "image cut in the pose": colmap("image 1", images=many(shot_bin(points=9), shot_bin()[:40], count=2)),
    "image name without end": colmap(
        "the name of image 0 does not end", images=many(shot_bin()[:64] + b"a.png" * 5)
    ),
    "image cut in the points": colmap("the 2D points of image 0", images=many(shot_bin(points=3))[:-1]),
    "huge count of 2d points": with_shot("the 2D points of image 0", count=2**64 - 1),
    "model unknown": with_lens("byte 8: camera id 1: the camera model is 11", 1, 11, code="CAMERA_DISTORTED"),
    "camera id twice": colmap("byte 64: camera id 1", many(lens_bin(), lens_bin())),
    "image name twice": colmap(
        "cameras 0 and 1 are both called 'a.png'", images=many(shot_bin(), shot_bin(2)), code="CAMERA_FILE"
    ),
    "no image": colmap("there is no camera in it", images=many(), code="CAMERA_NONE"),
    "camera id unknown": with_shot("names camera id 2, which cameras.bin", lens=2),
    "quaternion zero": with_shot("image id 1 (a.png) has the quaternion 0 0 0 0", q=(0, 0, 0, 0)),
    "quaternion nan": with_shot("nan 0 0 0", q=(math.nan, 0, 0, 0)),
    "translation huge": with_shot("translates by 1e+300", t=(0, 1e300, 0), code="CAMERA_INVALID"),
    "focal zero": with_lens(
        "byte 8: camera id 1: the focal length is 0.0", parameters=(0, 1, 2, 3), code="CAMERA_INVALID"
    ),
    "principal nan": with_lens("is nan", parameters=(50, 49, 2, math.nan), code="CAMERA_INVALID"),
    "width zero": with_lens("width is 0", width=0, code="CAMERA_INVALID"),
    "width absurd": with_lens("18446744073709551615", width=2**64 - 1, code="CAMERA_INVALID"),
    "pixels absurd": with_lens("4294836225 pixels", width=65535, height=65535, code="CAMERA_INVALID"),
    "name up": with_shot(
        "byte 8: image id 1 (../a.png): the name", name=b"../a.png\0", code="CAMERA_INVALID"
    ),
    "name empty": with_shot("1 to 1024 characters", name=b"\0", code="CAMERA_INVALID"),
    "name with a line end": with_shot("control character", name=b"a\nb\0", code="CAMERA_INVALID"),
    "name not utf-8": with_shot("is not UTF-8", name=b"\xff\xfe\0", code="CAMERA_INVALID"),
    "images missing": (
        {"cameras.bin": LENSES},
        "",
        "COLMAP_FILE_MISSING",
        "cameras.bin and images.bin or cameras.txt",
    ),
    "forms mixed": (
        {"sparse/0/cameras.bin": LENSES, "sparse/0/images.txt": TEXT["images.txt"]},
        "",
        "COLMAP_FILE_MISSING",
        "does not hold",
    ),
    "a file of the model": ({"images.bin": SHOTS}, "images.bin", "CAMERA_SOURCE", "give the folder"),
    **{
        f"{name} distorted": with_lens(
            f"camera id 1: the camera model is {name}",
            1,
            model.number,
            parameters=lens_parameters(name, 0 if model.fisheye else 0.01),
            code="CAMERA_DISTORTED",
        )
        for name, model in MODELS.items()
        if model.distortions
    },
    "distortion nan": with_lens(
        "distortion nan", 1, 2, parameters=lens_parameters("SIMPLE_RADIAL", math.nan), code="CAMERA_DISTORTED"
    ),
}

BAD_TEXT: dict[str, Bad] = {
    "empty": text("there is no camera", images=b"", code="CAMERA_NONE"),
    "short camera": text("line 2: a camera is ID MODEL", cameras=lens_line(b"", b"1 PINHOLE 40")),
    "few parameters": text("PINHOLE has 4 parameters; this has 3", cameras=lens_line(b"50 49 20")),
    "model unknown": text(
        "is CAHVOR", cameras=lens_line(b"1 2 3", b"1 CAHVOR 40 30 "), code="CAMERA_DISTORTED"
    ),
    "width long": text("18 digits", cameras=lens_line(b"5 4 2 1", b"1 PINHOLE " + b"9" * 5000 + b" 30 ")),
    "focal word": text("line 2: '50,5' is not a number", cameras=lens_line(b"50,5 49 20 15")),
    "focal underscore": text("'5_0' is not a number", cameras=lens_line(b"5_0 49 20 15")),
    "camera id twice": text("line 2", cameras=TEXT["cameras.txt"] * 2),
    "short image": text("line 1: an image is ID QW", images=b"5 1 0 0 0 0 0 0 1\n\n"),
    "camera id unknown": text("which cameras.txt", images=b"5 1 0 0 0 0 0 0 9 a\n\n"),
    "empty line lost": text(
        "line 2: 10 words stand where the 2D points of the image above are",
        images=b"5 1 0 0 0 0 0 0 1 a\n6 1 0 0 0 0 0 0 1 b\n7 1 0 0 0 0 0 0 1 c\n",
    ),
    "name up": text("'..'", images=b"5 1 0 0 0 0 0 0 1 a/../../b\n\n", code="CAMERA_INVALID"),
    "huge line": text(
        "line 3: the line has more than the 16777216", images=b"#\n\n" + b"5" * (18 << 20) + b"\n"
    ),
}

BAD_POINTS: dict[str, Bad] = {
    f"{suffix}: {name}": ({f"points3D.{suffix}": content}, f"points3D.{suffix}", "COLMAP_INVALID", message)
    for suffix, table in {
        "bin": {
            "empty": (b"", "the number of records"),
            "huge count": (many(count=2**63), "points of at least 51 bytes each"),
            "one more declared": (many(point_bin(track=9), count=2), "within point 1 of 2"),
            "cut in a track": (many(point_bin(track=3))[:-1], "within point 0 of 1"),
            "huge track": (many(point_bin(declared=2**64 - 1)), "within point 0 of 1"),
            "trailing": (many(point_bin()) + b"\0", "1 bytes follow"),
            "nan": (many(point_bin(), point_bin(xyz=(1, math.nan, 2))), "byte 59: point 1 is at 1.0 nan"),
        },
        "txt": {
            "short": (b"1 2 3 4 5 6 7\n", "line 1: a point is ID X Y Z R G B ERROR TRACK"),
            "word": (b"# x\n1 2 3 four 5 6 7 8\n", "line 2: '2 3 four 5 6 7' is not a row"),
            "underscore": (b"1 2 3_0 4 5 6 7 8\n", "3_0"),
            "nan": (b"1 nan 3 4 5 6 7 8\n", "the point is nan 3 4"),
            "color large": (b"1 2 3 4 5 256 7 8\n", "three colours 0 to 255"),
            "color nan": (b"1 2 3 4 5 nan 7 8\n", "three colours"),
        },
    }.items()
    for name, (content, message) in table.items()
} | {
    "no points": (
        {"images.bin": SHOTS, "cameras.bin": LENSES},
        "",
        "COLMAP_FILE_MISSING",
        "points3D.bin or points3D.txt",
    )
}
