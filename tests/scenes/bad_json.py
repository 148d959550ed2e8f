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


def of_json(code: str, message: str, document: Any, name: str = "cameras.json", **image: bytes) -> Bad:
    """Return the case of a document beside an image called a.png or a.jpg."""
    content = document if isinstance(document, bytes) else dump(document)
    files = {name: content} | {f"a.{suffix}": data for suffix, data in image.items()}
    return files, name, f"CAMERA_{code}", message


def in_transforms(code: str, message: str, path: str, to: Any = GONE) -> Bad:
    return of_json(code, message, changed(transforms(CAMERAS), path, to), "transforms.json")


def in_cameras(code: str, message: str, path: str, to: Any = GONE) -> Bad:
    return of_json(code, message, changed(cameras_json(CAMERAS), path, to))


def in_views(code: str, message: str, path: str, to: Any = GONE) -> Bad:
    return of_json(code, message, changed(views(CAMERAS), path, to), "views.json")


def bare(path: str = "./a", **more: Any) -> dict[str, Any]:
    """Return a NeRF-Synthetic document of one frame, which needs its image for the size."""
    frame = {"file_path": path, "transform_matrix": EYE}
    return {"camera_angle_x": 0.7, "frames": [frame | more]}


BAD_JSON: dict[str, Bad] = {
    "empty": of_json("FILE", "the file is empty", b""),
    "huge": of_json("FILE", "more than 16777216 bytes", b" " * (1 << 24) + b"[]"),
    "byte order mark": of_json("FILE", "byte-order mark", b"\xef\xbb\xbf[]"),
    "not utf-8": of_json("FILE", "byte 2 is 0xff", b'["\xff"]'),
    "not json": of_json("FILE", "the file is not JSON", b"ply\n"),
    "two documents": of_json("FILE", "line 2", b"[]\n[]"),
    "key twice": of_json("FILE", '"fx" twice', b'[{"fx": 1, "fx": 2}]'),
    "nan": of_json("FILE", "holds NaN", b'[{"fx": NaN}]'),
    "overflow": of_json("FILE", "1e999", b'[{"fx": 1e999}]'),
    "deep": of_json("FILE", "nests 100000 levels", b"[" * 100000),
    "integer": of_json("FILE", "5000 digits", b"[" + b"9" * 5000 + b"]"),
    "a number": of_json("SOURCE", "it is no file of cameras", b"7"),
    "another suffix": of_json("SOURCE", "'.npz' is not the suffix", b"PK", "views.npz"),
    "folder without cameras": (
        {"readme.md": b"x"},
        "",
        "CAMERA_SOURCE",
        "looked for sparse/0, sparse, transforms_train",
    ),
    # --- transforms.json
    "frames none": in_transforms("NONE", "there is no camera", "frames", []),
    "frames object": in_transforms("FILE", "/frames: it is an object; it must be an array", "frames", {}),
    "matrix missing": in_transforms(
        "FILE", '/frames/0: it lacks the key "transform_matrix"', "frames/0/transform_matrix"
    ),
    "matrix 3 x 4": in_transforms(
        "FILE",
        "/frames/1/transform_matrix: it is an array; it must be 4 x 4",
        "frames/1/transform_matrix",
        np.eye(4)[:3].tolist(),
    ),
    "matrix of words": in_transforms("FILE", "4 x 4 numbers", "frames/0/transform_matrix/2/2", "1"),
    "matrix singular": in_transforms(
        "INVALID",
        "/frames/0/transform_matrix: the rotation of the camera-to-world matrix",
        "frames/0/transform_matrix",
        np.diag([1.0, 1, 0, 1]).tolist(),
    ),
    "matrix mirrored": in_transforms(
        "INVALID", "determinant -1", "frames/0/transform_matrix", np.diag([1.0, 1, -1, 1]).tolist()
    ),
    "matrix huge": in_transforms("INVALID", "translates", "frames/0/transform_matrix/0/3", 1e308),
    "path up": in_transforms("INVALID", "'..'", "frames/0/file_path", "./../a.png"),
    "path surrogate": of_json(
        "FILE", "surrogate", b'{"frames": [{"file_path": "\\ud800"}]}', "transforms.json"
    ),
    "path hidden absolute": in_transforms("INVALID", "absolute", "frames/0/file_path", ".//etc/a.png"),
    "path twice": in_transforms("FILE", "'part/view_0.png'", "frames/1/file_path", "././part/view_0.png"),
    "width fraction": in_transforms(
        "FILE", "/frames/0/w: it is 40.5; it must be a whole", "frames/0/w", 40.5
    ),
    "focal missing": in_transforms("FILE", "/frames/0: it lacks the focal length", "frames/0/fl_x"),
    "principal huge": in_transforms("INVALID", "cx is 1e+30", "frames/0/cx", 1e30),
    "distorted": in_transforms("DISTORTED", "/k1: it is 0.01, a distortion", "k1", 0.01),
    "fisheye": in_transforms("DISTORTED", '"OPENCV_FISHEYE"', "camera_model", "OPENCV_FISHEYE"),
    "model number": in_transforms("FILE", "/camera_model: it is 4", "camera_model", 4),
    "is_fisheye": in_transforms("DISTORTED", "/is_fisheye", "is_fisheye", True),
    "image missing": of_json("IMAGE", "/frames/0: the size is needed", bare(), "transforms.json"),
    "image without header": of_json(
        "IMAGE", "neither a PNG nor a JPEG", bare(), "transforms.json", png=b"GIF89a"
    ),
    "image of no lines": of_json(
        "IMAGE", "or damaged within its header", bare("a.jpg"), "transforms.json", jpg=jpeg(5, 0)
    ),
    "angle zero": of_json(
        "INVALID",
        "camera_angle_x is 0.0; it must be an angle in radians",
        bare(w=4, h=4, camera_angle_x=0),
        "transforms.json",
    ),
    "angle in degrees": of_json("INVALID", "is 45.0", bare(w=4, h=4, camera_angle_x=45), "transforms.json"),
    # --- cameras.json
    "list of numbers": of_json("FILE", "/0: it is 1; it must be an object", [1]),
    "id twice": in_cameras("FILE", "/1/id: camera id 0 occurs twice", "1/id", 0),
    "id taken": of_json(
        "FILE", "/1: camera id 1", changed(changed(cameras_json(CAMERAS), "0/id", 1), "1/id")
    ),
    "made name taken": of_json(
        "FILE",
        "both called 'img-1'",
        [
            e | {"img_name": n}
            for e, n in zip(cameras_json(some_cameras(3)), ("img", "img", "img-1"), strict=True)
        ],
    ),
    "position short": in_cameras(
        "FILE", "/0/position: it is [1, 2]; it must be 3 numbers", "0/position", [1, 2]
    ),
    "rotation zero": in_cameras("INVALID", "position and rotation", "0/rotation", [[0, 0, 0]] * 3),
    "height zero": in_cameras("INVALID", "/0: height is 0", "0/height", 0),
    # --- views.json
    "schema unknown": in_views("FILE", '/schema: it is "msb.views/2"', "schema", "msb.views/2"),
    "cameras missing": in_views("FILE", 'the document lacks the key "cameras"', "cameras"),
    "key unknown": in_views("FILE", 'the document has the unknown key "backgroud"', "backgroud", [0, 0, 0]),
    "key with an escape": in_views("FILE", "\\x1b[31m", "\x1b[31m" * 99, 1),
    "background of four": in_views(
        "FILE", "/background: it is [1, 1, 1, 1]; it must be 3", "background", [1] * 4
    ),
    "background bright": in_views("FILE", "/background: it is [1, 1, 255]", "background", [1, 1, 255]),
    "pose transposed": in_views(
        "INVALID",
        "/cameras/0: world_to_camera has the last row",
        "cameras/0/world_to_camera",
        CAMERAS[0].world_to_camera.T.tolist(),
    ),
    "names equal": in_views("FILE", "cameras 0 and 1 are both", "cameras/0/name", "part/view_1.png"),
    "split unknown": in_views("INVALID", "/cameras/1: split is 'all'", "cameras/1/split", "all"),
    "source size of one": in_views("INVALID", "/cameras/0: the size is [5]", "cameras/0/source_size", [5]),
}
