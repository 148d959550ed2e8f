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


def of_json(
    message: str, document: Any, name: str = "cameras.json", code: str = "FILE", **image: bytes
) -> Bad:
    """Return the case of a document beside an image called a.png or a.jpg."""
    content = document if isinstance(document, bytes) else dump(document)
    files = {name: content} | {f"a.{suffix}": data for suffix, data in image.items()}
    return files, name, f"CAMERA_{code}", message


def in_transforms(message: str, path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(message, changed(transforms(CAMERAS), path, to), "transforms.json", code)


def in_cameras(message: str, path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(message, changed(cameras_json(CAMERAS), path, to), code=code)


def in_views(message: str, path: str, to: Any = GONE, code: str = "FILE") -> Bad:
    return of_json(message, changed(views(CAMERAS), path, to), "views.json", code)


def bare(path: str = "./a", **more: Any) -> dict[str, Any]:
    """Return a NeRF-Synthetic document of one frame, which needs its image for the size."""
    frame = {"file_path": path, "transform_matrix": EYE}
    return {"camera_angle_x": 0.7, "frames": [frame | more]}


BAD_JSON: dict[str, Bad] = {
    "empty": of_json("the file is empty", b""),
    "huge": of_json("more than 16777216 bytes", b" " * (1 << 24) + b"[]"),
    "byte order mark": of_json("byte-order mark", b"\xef\xbb\xbf[]"),
    "not utf-8": of_json("byte 2 is 0xff", b'["\xff"]'),
    "not json": of_json("the file is not JSON", b"ply\n"),
    "two documents": of_json("line 2", b"[]\n[]"),
    "key twice": of_json('"fx" twice', b'[{"fx": 1, "fx": 2}]'),
    "nan": of_json("holds NaN", b'[{"fx": NaN}]'),
    "overflow": of_json("1e999", b'[{"fx": 1e999}]'),
    "deep": of_json("nests 100000 levels", b"[" * 100000),
    "integer": of_json("5000 digits", b"[" + b"9" * 5000 + b"]"),
    "a number": of_json("it is no file of cameras", b"7", code="SOURCE"),
    "another suffix": of_json("'.npz' is not the suffix", b"PK", "views.npz", code="SOURCE"),
    "folder without cameras": (
        {"readme.md": b"x"},
        "",
        "CAMERA_SOURCE",
        "looked for sparse/0, sparse, transforms_train",
    ),
    # --- transforms.json
    "frames none": in_transforms("there is no camera", "frames", [], code="NONE"),
    "frames object": in_transforms("/frames: it is an object; it must be an array", "frames", {}),
    "matrix missing": in_transforms(
        '/frames/0: it lacks the key "transform_matrix"', "frames/0/transform_matrix"
    ),
    "matrix 3 x 4": in_transforms(
        "/frames/1/transform_matrix: it is an array; it must be 4 x 4",
        "frames/1/transform_matrix",
        np.eye(4)[:3].tolist(),
    ),
    "matrix of words": in_transforms("4 x 4 numbers", "frames/0/transform_matrix/2/2", "1"),
    "matrix singular": in_transforms(
        "/frames/0/transform_matrix: the rotation of the camera-to-world matrix",
        "frames/0/transform_matrix",
        np.diag([1.0, 1, 0, 1]).tolist(),
        code="INVALID",
    ),
    "matrix mirrored": in_transforms(
        "determinant -1", "frames/0/transform_matrix", np.diag([1.0, 1, -1, 1]).tolist(), code="INVALID"
    ),
    "matrix huge": in_transforms("translates", "frames/0/transform_matrix/0/3", 1e308, code="INVALID"),
    "path up": in_transforms("'..'", "frames/0/file_path", "./../a.png", code="INVALID"),
    "path surrogate": of_json("surrogate", b'{"frames": [{"file_path": "\\ud800"}]}', "transforms.json"),
    "path hidden absolute": in_transforms("absolute", "frames/0/file_path", ".//etc/a.png", code="INVALID"),
    "path twice": in_transforms("'part/view_0.png'", "frames/1/file_path", "././part/view_0.png"),
    "width fraction": in_transforms("/frames/0/w: it is 40.5; it must be a whole", "frames/0/w", 40.5),
    "focal missing": in_transforms("/frames/0: it lacks the focal length", "frames/0/fl_x"),
    "principal huge": in_transforms("cx is 1e+30", "frames/0/cx", 1e30, code="INVALID"),
    "distorted": in_transforms("/k1: it is 0.01, a distortion", "k1", 0.01, code="DISTORTED"),
    "fisheye": in_transforms('"OPENCV_FISHEYE"', "camera_model", "OPENCV_FISHEYE", code="DISTORTED"),
    "model number": in_transforms("/camera_model: it is 4", "camera_model", 4),
    "is_fisheye": in_transforms("/is_fisheye", "is_fisheye", True, code="DISTORTED"),
    "image missing": of_json("/frames/0: the size is needed", bare(), "transforms.json", code="IMAGE"),
    "image without header": of_json(
        "neither a PNG nor a JPEG", bare(), "transforms.json", png=b"GIF89a", code="IMAGE"
    ),
    "image of no lines": of_json(
        "or damaged within its header", bare("a.jpg"), "transforms.json", jpg=jpeg(5, 0), code="IMAGE"
    ),
    "angle zero": of_json(
        "camera_angle_x is 0.0; it must be an angle in radians",
        bare(w=4, h=4, camera_angle_x=0),
        "transforms.json",
        code="INVALID",
    ),
    "angle in degrees": of_json(
        "is 45.0", bare(w=4, h=4, camera_angle_x=45), "transforms.json", code="INVALID"
    ),
    # --- cameras.json
    "list of numbers": of_json("/0: it is 1; it must be an object", [1]),
    "id twice": in_cameras("/1/id: camera id 0 occurs twice", "1/id", 0),
    "id taken": of_json("/1: camera id 1", changed(changed(cameras_json(CAMERAS), "0/id", 1), "1/id")),
    "made name taken": of_json(
        "both called 'img-1'",
        [
            e | {"img_name": n}
            for e, n in zip(cameras_json(some_cameras(3)), ("img", "img", "img-1"), strict=True)
        ],
    ),
    "position short": in_cameras("/0/position: it is [1, 2]; it must be 3 numbers", "0/position", [1, 2]),
    "rotation zero": in_cameras("position and rotation", "0/rotation", [[0, 0, 0]] * 3, code="INVALID"),
    "height zero": in_cameras("/0: height is 0", "0/height", 0, code="INVALID"),
    # --- views.json
    "schema unknown": in_views('/schema: it is "msb.views/2"', "schema", "msb.views/2"),
    "cameras missing": in_views('the document lacks the key "cameras"', "cameras"),
    "key unknown": in_views('the document has the unknown key "backgroud"', "backgroud", [0, 0, 0]),
    "key with an escape": in_views("\\x1b[31m", "\x1b[31m" * 99, 1),
    "background of four": in_views("/background: it is [1, 1, 1, 1]; it must be 3", "background", [1] * 4),
    "background bright": in_views("/background: it is [1, 1, 255]", "background", [1, 1, 255]),
    "pose transposed": in_views(
        "/cameras/0: world_to_camera has the last row",
        "cameras/0/world_to_camera",
        CAMERAS[0].world_to_camera.T.tolist(),
        code="INVALID",
    ),
    "names equal": in_views("cameras 0 and 1 are both", "cameras/0/name", "part/view_1.png"),
    "split unknown": in_views("/cameras/1: split is 'all'", "cameras/1/split", "all", code="INVALID"),
    "source size of one": in_views(
        "/cameras/0: the size is [5]", "cameras/0/source_size", [5], code="INVALID"
    ),
}
