"""JSON files of cameras that must be refused; see bad_cameras.py."""

from __future__ import annotations

from typing import Any

import numpy as np

from .builders import Bad, cameras_json, dump, jpeg, some_cameras, transforms, views

CAMERAS = some_cameras(2)
GONE = object()
EYE = np.eye(4).tolist()


def changed(document: Any, path: str, to: Any = GONE) -> Any:
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
    """Return the case of a document beside an image called a.png or a.jpg."""
    content = document if isinstance(document, bytes) else dump(document)
    files = {name: content} | {f"a.{suffix}": data for suffix, data in image.items()}
    return files, name, f"CAMERA_{code}"


def in_transforms(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(changed(transforms(CAMERAS), path, to), "transforms.json", code)


def in_cameras(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(changed(cameras_json(CAMERAS), path, to), code=code)


def in_views(path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(changed(views(CAMERAS), path, to), "views.json", code)


def bare(path: str = "./a", **more: Any) -> dict[str, Any]:
    """Return a NeRF-Synthetic document of one frame, which needs its image for the size."""
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
    "frames object": in_transforms("frames", {}),
    "matrix missing": in_transforms("frames/0/transform_matrix"),
    "matrix of words": in_transforms("frames/0/transform_matrix/2/2", "1"),
    "matrix singular": in_transforms(
        "frames/0/transform_matrix", np.diag([1.0, 1, 0, 1]).tolist(), code="INVALID"
    ),
    "path up": in_transforms("frames/0/file_path", "./../a.png", code="INVALID"),
    "path twice": in_transforms("frames/1/file_path", "././part/view_0.png"),
    "width fraction": in_transforms("frames/0/w", 40.5),
    "focal missing": in_transforms("frames/0/fl_x"),
    "principal huge": in_transforms("frames/0/cx", 1e30, code="INVALID"),
    "distorted": in_transforms("k1", 0.01, code="DISTORTED"),
    "fisheye": in_transforms("camera_model", "OPENCV_FISHEYE", code="DISTORTED"),
    "model number": in_transforms("camera_model", 4),
    "is_fisheye": in_transforms("is_fisheye", True, code="DISTORTED"),
    "image missing": of_json(bare(), "transforms.json", code="IMAGE"),
    "image of no lines": of_json(bare("a.jpg"), "transforms.json", jpg=jpeg(5, 0), code="IMAGE"),
    # --- cameras.json
    "list of numbers": of_json([1]),
    "id twice": in_cameras("1/id", 0),
    "position short": in_cameras("0/position", [1, 2]),
    # --- views.json
    "schema unknown": in_views("schema", "msb.views/2"),
    "cameras missing": in_views("cameras"),
    "key unknown": in_views("backgroud", [0, 0, 0]),
    "background of four": in_views("background", [1] * 4),
    "background bright": in_views("background", [1, 1, 255]),
}
