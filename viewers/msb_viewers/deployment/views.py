"""The views of a comparison: cameras with their photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from msb.base.paths import SpelledFiles
from msb.errors import UsageError
from msb.scenes import Camera
from msb.scenes.datasets import Scene
from msb_viewers.deployment.difference import resize

_NO_PHOTOGRAPH = "the dataset has no photograph for this camera"
_DISTORTED = "the photograph has lens distortion; pass --scene, which removes it"


@dataclass(frozen=True)
class View:
    """A camera with the size of the compared images, and its photograph. If the photograph is missing, `why`
    is the reason.

    If `scene` is set, the photograph is masked and resized by the rules of the dataset.
    """

    name: str
    camera: Camera
    photograph: Path | None = None
    why: str = _NO_PHOTOGRAPH
    scene: Scene | None = None


def dataset_views(
    cameras: Sequence[Camera],
    images: Path | None = None,
    scale: float | None = None,
    *,
    beside: Path | None = None,
) -> list[View]:
    """Return a view for each camera, with its photograph if a photograph exists.

    Photographs in the folder `images` have the names of the cameras, with any file suffix. If `images` is
    missing, the dataset provides the paths of the photographs. Without a dataset, photographs are in the
    folder `beside`. A view has the size of its photograph. If `scale` is given, the size of a view is the
    camera's size times `scale`, as in `msb render`.
    """
    if images is not None and not images.is_dir():
        raise UsageError("USAGE", "--image-folder: the folder does not exist", file=images)
    views = []
    folder = images or beside
    files = None if folder is None else SpelledFiles(folder)
    for index, camera in enumerate(cameras):
        photograph = _find_photograph(camera, files, by_name=images is not None)
        why = _NO_PHOTOGRAPH if images is None else f"{images.name} contains no image of this camera"
        if photograph is not None and camera.distortion is not None:
            photograph, why = None, _DISTORTED
        if scale is not None:
            camera = camera.scaled(scale)
        elif photograph is not None:
            from msb.scenes import image_size

            camera = camera.resized(*image_size(photograph))
        views.append(View(camera.name or f"camera {index}", camera, photograph, why))
    if images is not None and not any(view.photograph or view.why == _DISTORTED for view in views):
        names = ", ".join(view.name for view in views[:3])
        text = f"--image-folder: the folder contains no image with the name of a camera ({names}, ...)"
        raise UsageError("USAGE", text, file=images)
    return views


def scene_views(scene: Scene, cameras: Sequence[Camera], scale: float | None = None) -> list[View]:
    """Return views of some cameras of a scene.

    If `scale` is given, the size of the views is multiplied by `scale`.
    """
    return [
        View(
            camera.name or f"camera {index}",
            camera if scale is None else camera.scaled(scale),
            camera.image_path if camera.image_path is not None and camera.image_path.is_file() else None,
            scene=scene,
        )
        for index, camera in enumerate(cameras)
    ]


def _find_photograph(camera: Camera, files: SpelledFiles | None, *, by_name: bool) -> Path | None:
    """Return the path of a camera's photograph.

    If `by_name` is true, search `files` for the camera's name.
    """
    from msb.metrics import IMAGE_SUFFIXES

    if not by_name and camera.image_path is not None:
        return camera.image_path if camera.image_path.is_file() else None
    if files is None or camera.name is None:
        return None
    suffixes = [suffix for kind in IMAGE_SUFFIXES[:3] for suffix in (kind, kind.upper())]
    exact = PurePosixPath(camera.name)
    names = [exact, *(exact.with_suffix(s) for s in suffixes), *(f"{exact}{s}" for s in suffixes)]
    candidates = (files.find(str(name)) for name in names)
    return next((path for path in candidates if path.is_file() and path.suffix in suffixes), None)


def read_photograph(view: View, background: tuple[float, float, float]) -> NDArray[np.uint8]:
    """Return the photograph of a view (H, W, 3), in the size of the camera.

    Transparent parts show the `background`.
    """
    from msb.metrics import read_image
    from msb.metrics.ground_truth import ground_truth
    from msb.render.images import to_bytes

    if view.scene is not None:
        return to_bytes(ground_truth(replace(view.scene, background=background), view.camera))
    image = read_image(str(view.photograph), background=background)
    if image.dtype != np.uint8:
        image = to_bytes(image)
    return resize(image, view.camera.width, view.camera.height)


def views_at(cameras: list[Camera], place: Path, images: Path | None, scale: float | None) -> list[View]:
    """Return views of the cameras that were read from `place`.

    Photographs are in the folder `place` or in `images`.
    """
    from msb.scenes.datasets import find_photographs

    beside = place if place.is_dir() else place.parent
    if images is not None:
        images = beside / images if (beside / images).is_dir() else images
    elif not any(camera.image_path and camera.image_path.is_file() for camera in cameras):
        beside_them = find_photographs(place, cameras)
        images = None if beside_them is None else beside_them[0]
    return dataset_views(cameras, images, scale, beside=beside)
