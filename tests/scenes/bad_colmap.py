"""COLMAP models and points that must be refused; see bad_cameras.py."""

from __future__ import annotations

import math
from typing import Any

from msb.scenes.colmap_models import MODELS

from .builders import Bad, lens_bin, lens_parameters, many, point_bin, shot_bin

LENSES, SHOTS = many(lens_bin()), many(shot_bin())
TEXT = {"cameras.txt": b"1 PINHOLE 40 30 50 49 20 15\n", "images.txt": b"5 1 0 0 0 0 0 0 1 a.png\n1 2 -1\n"}


def colmap(cameras: bytes = LENSES, images: bytes = SHOTS, code: str = "COLMAP_INVALID") -> Bad:
    return {"cameras.bin": cameras, "images.bin": images}, "", code


def with_lens(*values: Any, code: str = "COLMAP_INVALID", **more: Any) -> Bad:
    return colmap(many(lens_bin(*values, **more)), code=code)


def with_shot(*values: Any, code: str = "COLMAP_INVALID", **more: Any) -> Bad:
    return colmap(images=many(shot_bin(*values, **more)), code=code)


def text(code: str = "COLMAP_INVALID", **change: bytes) -> Bad:
    return {**TEXT, **{f"{key}.txt": value for key, value in change.items()}}, "", code


def lens_line(parameters: bytes, head: bytes = b"1 PINHOLE 40 30 ") -> bytes:
    return b"# Camera list\n" + head + parameters + b"\n"


BAD_COLMAP: dict[str, Bad] = {
    "empty cameras": colmap(b""),
    "huge count of cameras": colmap(many(count=2**64 - 1)),
    "camera trailing": colmap(LENSES + b"more"),
    "image name without end": colmap(images=many(shot_bin()[:64] + b"a.png" * 5)),
    "huge count of 2d points": with_shot(count=2**64 - 1),
    "model unknown": with_lens(1, 11, code="CAMERA_DISTORTED"),
    "camera id twice": colmap(many(lens_bin(), lens_bin())),
    "image name twice": colmap(images=many(shot_bin(), shot_bin(2)), code="CAMERA_FILE"),
    "no image": colmap(images=many(), code="CAMERA_NONE"),
    "camera id unknown": with_shot(lens=2),
    "quaternion nan": with_shot(q=(math.nan, 0, 0, 0)),
    "translation huge": with_shot(t=(0, 1e300, 0), code="CAMERA_INVALID"),
    "principal nan": with_lens(parameters=(50, 49, 2, math.nan), code="CAMERA_INVALID"),
    "width absurd": with_lens(width=2**64 - 1, code="CAMERA_INVALID"),
    "name up": with_shot(name=b"../a.png\0", code="CAMERA_INVALID"),
    "name with a line end": with_shot(name=b"a\nb\0", code="CAMERA_INVALID"),
    "name not utf-8": with_shot(name=b"\xff\xfe\0", code="CAMERA_INVALID"),
    "forms mixed": (
        {"sparse/0/cameras.bin": LENSES, "sparse/0/images.txt": TEXT["images.txt"]},
        "",
        "COLMAP_FILE_MISSING",
    ),
    "a file of the model": ({"images.bin": SHOTS}, "images.bin", "CAMERA_SOURCE"),
    **{
        f"{name} distorted": with_lens(
            1,
            model.number,
            parameters=lens_parameters(name, 0 if model.fisheye else 0.01),
            code="CAMERA_DISTORTED",
        )
        for name, model in MODELS.items()
        if model.distortions
    },
    "distortion nan": with_lens(
        1, 2, parameters=lens_parameters("SIMPLE_RADIAL", math.nan), code="CAMERA_DISTORTED"
    ),
}

BAD_TEXT: dict[str, Bad] = {
    "empty": text(images=b"", code="CAMERA_NONE"),
    "short camera": text(cameras=lens_line(b"", b"1 PINHOLE 40")),
    "few parameters": text(cameras=lens_line(b"50 49 20")),
    "model unknown": text(cameras=lens_line(b"1 2 3", b"1 CAHVOR 40 30 "), code="CAMERA_DISTORTED"),
    "width long": text(cameras=lens_line(b"5 4 2 1", b"1 PINHOLE " + b"9" * 5000 + b" 30 ")),
    "focal word": text(cameras=lens_line(b"50,5 49 20 15")),
    "short image": text(images=b"5 1 0 0 0 0 0 0 1\n\n"),
    "empty line lost": text(images=b"5 1 0 0 0 0 0 0 1 a\n6 1 0 0 0 0 0 0 1 b\n7 1 0 0 0 0 0 0 1 c\n"),
    "huge line": text(images=b"#\n\n" + b"5" * (18 << 20) + b"\n"),
}

BAD_POINTS: dict[str, Bad] = {
    f"{suffix}: {name}": ({f"points3D.{suffix}": content}, f"points3D.{suffix}", "COLMAP_INVALID")
    for suffix, table in {
        "bin": {
            "huge count": many(count=2**63),
            "huge track": many(point_bin(declared=2**64 - 1)),
            "trailing": many(point_bin()) + b"\0",
            "nan": many(point_bin(), point_bin(xyz=(1, math.nan, 2))),
        },
        "txt": {
            "short": b"1 2 3 4 5 6 7\n",
            "nan": b"1 nan 3 4 5 6 7 8\n",
        },
    }.items()
    for name, content in table.items()
} | {"no points": ({"images.bin": SHOTS, "cameras.bin": LENSES}, "", "COLMAP_FILE_MISSING")}
