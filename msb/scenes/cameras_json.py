"""Read cameras.json, which the 3DGS family writes beside a trained model.

Source: `graphdeco-inria/gaussian-splatting`: utils/camera_utils.py, scene/__init__.py. cameras.json stores no
principal point. Image sizes and focal lengths in cameras.json belong to the original photographs.
"""

from collections import Counter

import numpy as np

from msb.scenes.camera import Camera
from msb.scenes.json_node import Node
from msb.scenes.poses import invert_pose


def read(root: Node) -> list[Camera]:
    """Return the cameras of the file: first the test split, then the training split.

    `img_name` is the image's file name up to its first dot. Images with equal `img_name` get the suffix
    "-ID".
    """
    names = Counter(node["img_name"].text() for node in root.items())
    cameras = []
    seen: set[int] = set()
    for index, node in enumerate(root.items()):
        identity = node.get("id")
        number = index if identity is None else identity.whole()
        if number in seen:
            raise (identity or node).error("CAMERA_FILE", f"camera id {number} occurs twice")
        seen.add(number)
        name = node["img_name"].text()
        cameras.append(_camera(node, name if names[name] == 1 else f"{name}-{number}"))
    return cameras


def _camera(node: Node, name: str) -> Camera:
    """Return the camera of one entry."""
    pose = np.eye(4)
    pose[:3, :3] = node["rotation"].array(3, 3)
    pose[:3, 3] = node["position"].array(3)
    with node.locating():
        width, height = node["width"].whole(), node["height"].whole()
        return Camera(
            width,
            height,
            node["fx"].number(),
            node["fy"].number(),
            width / 2,
            height / 2,
            invert_pose(pose, "the camera-to-world matrix from position and rotation"),
            name,
        )
