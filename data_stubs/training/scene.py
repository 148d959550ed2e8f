"""A scene for the trainer: cameras and photographs as in `msb`, and initial points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.errors import MsbError
from msb.metrics.ground_truth import ground_truth
from msb.scenes import read_points
from msb.scenes.datasets.read import dataset_of, scene_at

if TYPE_CHECKING:
    from msb.scenes import Camera

_RANDOM_POINTS = 4000


@dataclass(frozen=True, eq=False)
class Capture:
    """A scene's views with their photographs (H, W, 3) over the background, in [0, 1], and its points.

    `about` is the text that describes the data in official files. DiffSoup has a separate script for
    `synthetic` scenes.
    """

    train: list[tuple[Camera, NDArray[np.float32]]]
    test: list[tuple[Camera, NDArray[np.float32]]]
    background: NDArray[np.float64]
    points: NDArray[np.float64]
    colors: NDArray[np.float64]
    about: dict[str, str]
    synthetic: bool

    @property
    def white(self) -> bool:
        """Whether the background is white."""
        return bool(self.background.min() >= 1)


def read_capture(
    path: Path,
    method: str,
    image_folder: str | None,
    resolution: int | None,
    seed: int,
    *,
    points: Path | None = None,
) -> Capture:
    """Read the scene at `path` with the evaluation rules of `method`.

    `points` is the folder of another scene in the same coordinate frame; its SfM points replace those of the
    scene.
    """
    at = scene_at(Path(path), dataset_of(path), method, image_folder=image_folder, resolution=resolution)
    scene = at.read()
    views = [
        [(camera, ground_truth(scene, camera).astype(np.float32)) for camera in cameras]
        for cameras in (scene.train, scene.test)
    ]
    try:
        places, colors = read_points(points or path)
        colors = colors / 255
    except MsbError:
        if points is not None:
            raise
        places, colors = np.zeros((0, 3)), np.zeros((0, 3))
    if len(places) < 16:
        places = _anywhere([camera for camera, _ in views[0]], np.random.default_rng(seed))
        colors = np.full(places.shape, 0.5)
    about = {"source_path": str(path), "images": scene.image_folder}
    synthetic = scene.layout == "blender"
    return Capture(*views, np.array(scene.background), places, np.asarray(colors), about, synthetic)


def _anywhere(cameras: list[Camera], random: np.random.Generator) -> NDArray[np.float64]:
    """Return random points in the ball around the point nearest to all camera axes."""
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    centers = np.stack([camera.center for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    middle = np.linalg.lstsq(across.sum(axis=0), (across @ centers[..., None]).sum(axis=0)[:, 0])[0]
    distance = np.linalg.norm(centers - middle, axis=1).mean()
    half = min(min(camera.fov_x, camera.fov_y) for camera in cameras) / 2
    directions = random.normal(size=(_RANDOM_POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = 0.8 * distance * np.sin(half) * random.random((_RANDOM_POINTS, 1)) ** (1 / 3)
    return np.asarray(middle + reach * directions)
