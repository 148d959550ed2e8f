"""Cameras and scenes: the camera class, readers of camera files, and camera paths.

The conventions and formats are described in docs/cameras.md, the datasets in docs/datasets.md.
"""

from msb.scenes.camera import Camera
from msb.scenes.colmap import read_points
from msb.scenes.datasets import Scene, read_scene
from msb.scenes.image_size import image_size
from msb.scenes.paths import interpolate_cameras, turntable
from msb.scenes.poses import from_opengl, invert_pose
from msb.scenes.read import read_cameras
from msb.scenes.sets import sorted_by_stem, split_every_8th, stem
from msb.scenes.views_json import ViewsFile, read_views, write_cameras

__all__ = [
    "Camera",
    "Scene",
    "ViewsFile",
    "from_opengl",
    "image_size",
    "interpolate_cameras",
    "invert_pose",
    "read_cameras",
    "read_points",
    "read_scene",
    "read_views",
    "sorted_by_stem",
    "split_every_8th",
    "stem",
    "turntable",
    "write_cameras",
]
