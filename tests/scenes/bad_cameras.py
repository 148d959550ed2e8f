"""Invalid cameras by name: files, the path to read, and the error code."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from msb.scenes import read_cameras, read_points

from .builders import (
    Bad,
    Files,
    cameras_json,
    colmap_txt,
    dump,
    jpeg,
    lens_bin,
    lens_parameters,
    many,
    point_bin,
    shot_bin,
    some_cameras,
    transforms,
    views,
    write,
)

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
    "image name without end": colmap(images=many(shot_bin()[:64] + b"a.png" * 5)),
    "model unknown": with_lens(1, 18, code="CAMERA_DISTORTED"),
    "camera id twice": colmap(many(lens_bin(), lens_bin())),
    "image name twice": colmap(images=many(shot_bin(), shot_bin(2)), code="CAMERA_FILE"),
    "no image": colmap(images=many(), code="CAMERA_NONE"),
    "camera id unknown": with_shot(lens=2),
    "quaternion nan": with_shot(q=(math.nan, 0, 0, 0)),
    "translation huge": with_shot(t=(0, 1e300, 0), code="CAMERA_INVALID"),
    "width absurd": with_lens(width=2**64 - 1, code="CAMERA_INVALID"),
    "name not utf-8": with_shot(name=b"\xff\xfe\0", code="CAMERA_INVALID"),
    "forms mixed": (
        {"sparse/0/cameras.bin": LENSES, "sparse/0/images.txt": TEXT["images.txt"]},
        "",
        "COLMAP_FILE_MISSING",
    ),
    "a file of the model": ({"images.bin": SHOTS}, "images.bin", "CAMERA_SOURCE"),
    "panorama": with_lens(1, 17, parameters=(40, 30), code="CAMERA_DISTORTED"),
    "distortion nan": with_lens(
        1, 2, parameters=lens_parameters("SIMPLE_RADIAL", math.nan), code="CAMERA_DISTORTED"
    ),
}

BAD_TEXT: dict[str, Bad] = {
    "empty": text(images=b"", code="CAMERA_NONE"),
    "short camera": text(cameras=lens_line(b"", b"1 PINHOLE 40")),
    "few parameters": text(cameras=lens_line(b"50 49 20")),
    "model unknown": text(cameras=lens_line(b"1 2 3", b"1 CAHVOR 40 30 "), code="CAMERA_DISTORTED"),
    "focal word": text(cameras=lens_line(b"50,5 49 20 15")),
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


CAMERAS = some_cameras(2)
GONE = object()
EYE = np.eye(4).tolist()


def replace_at(document: Any, path: str, to: Any = GONE) -> Any:
    """Return the JSON data with the value at `path` replaced, or removed."""
    *folders, key = (int(step) if step.isdecimal() else step for step in path.split("/"))
    place = document
    for step in folders:
        place = place[step]
    if to is GONE:
        del place[key]
    else:
        place[key] = to
    return document


def of_json(document: Any, name: str = "cameras.json", code: str = "FILE", **image: bytes) -> Bad:
    """Return a case: a JSON document beside an image called a.png or a.jpg."""
    content = document if isinstance(document, bytes) else dump(document)
    files = {name: content} | {f"a.{suffix}": data for suffix, data in image.items()}
    return files, name, f"CAMERA_{code}"


def in_transforms(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(replace_at(transforms(CAMERAS), path, to), "transforms.json", code)


def in_cameras(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(replace_at(cameras_json(CAMERAS), path, to), code=code)


def in_views(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(replace_at(views(CAMERAS), path, to), "views.json", code)


def bare(path: str = "./a", **more: Any) -> dict[str, Any]:
    """Return a NeRF-Synthetic document of one frame; the size must be read from the image."""
    frame = {"file_path": path, "transform_matrix": EYE}
    return {"camera_angle_x": 0.7, "frames": [frame | more]}


BAD_JSON: dict[str, Bad] = {
    "not json": of_json(b"ply\n"),
    "nan": of_json(b'[{"fx": NaN}]'),
    "a number": of_json(b"7", code="SOURCE"),
    "another suffix": of_json(b"PK", "views.npz", code="SOURCE"),
    "folder without cameras": ({"readme.md": b"x"}, "", "CAMERA_SOURCE"),
    # --- transforms.json
    "frames none": in_transforms("frames", [], code="NONE"),
    "matrix missing": in_transforms("frames/0/transform_matrix"),
    "matrix singular": in_transforms(
        "frames/0/transform_matrix", np.diag([1.0, 1, 0, 1]).tolist(), code="INVALID"
    ),
    "path twice": in_transforms("frames/1/file_path", "././part/view_0.png"),
    "width fraction": in_transforms("frames/0/w", 40.5),
    "focal missing": in_transforms("frames/0/fl_x"),
    "distortion not a number": in_transforms("k1", "0.01"),
    "distortion of three numbers": in_transforms("distortion_params", [1, 2, 3]),
    "panorama": in_transforms("camera_model", "EQUIRECTANGULAR", code="DISTORTED"),
    "image missing": of_json(bare(), "transforms.json", code="IMAGE"),
    "image of no lines": of_json(bare("a.jpg"), "transforms.json", jpg=jpeg(5, 0), code="IMAGE"),
    # --- cameras.json
    "id twice": in_cameras("1/id", 0),
    # --- views.json
    "schema unknown": in_views("schema", "msb.views/2"),
    "cameras missing": in_views("cameras"),
    "key unknown": in_views("backgroud", [0, 0, 0]),
    "background bright": in_views("background", [1, 1, 255]),
}


BAD: dict[str, Bad] = {
    f"{group}: {name}": bad
    for group, table in (
        ("colmap", BAD_COLMAP),
        ("text", BAD_TEXT),
        ("points", BAD_POINTS),
        ("json", BAD_JSON),
    )
    for name, bad in table.items()
}
"""All cases. Cases of the group "points" are read by `read_points`, and all other cases by `read_cameras`."""


def read_case(name: str, root: Path) -> Any:
    """Write the files of a case below `root`, and read them."""
    files, target, _ = BAD[name]
    read = read_points if name.startswith("points") else read_cameras
    return read(write(root, files) / target)


SMALL: dict[str, Files] = {
    "binary": {"cameras.bin": many(lens_bin(), lens_bin(2, 0, parameters=(5, 2, 1))), "images.bin": SHOTS},
    "text": colmap_txt(CAMERAS),
    "points3D.bin": {"points3D.bin": many(point_bin(), point_bin(track=2))},
    "points3D.txt": {"points3D.txt": b"# p\n1 2 3 4 5 6 7 8 9 10\n2 0.5 -1 1e3 0 255 9 0.1\n"},
    "transforms.json": {"transforms.json": dump(bare("a.jpg")), "a.jpg": jpeg(5, 4)},
    "cameras.json": {"cameras.json": dump(cameras_json(CAMERAS[:1]))},
    "views.json": {"views.json": dump(views(CAMERAS[:1], background=[0, 0.5, 1]))},
}
"""Valid files to be truncated and modified, one per kind of source."""
