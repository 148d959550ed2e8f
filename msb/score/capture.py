"""The photographs of a capture: the held-out ones for the score, and features of all for the pose."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.files import file_sha256
from msb.base.version import __version__
from msb.errors import SceneError
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from msb.scenes.datasets import Scene, read_scene
from msb.score.features import detect_features
from msb.score.pose import GREY, MOST_PHOTOGRAPHS, Photograph, spread_numbers

Image = NDArray[np.float32]

# Longer side in pixels of the photographs in which features are searched. Smaller ones than half of it are
# enlarged twice.
_SEARCHED = 800
# Largest number of features of a photograph.
_FEATURES = 2000


@dataclass(frozen=True, eq=False)
class TestView:
    """A held-out view: its camera, its photograph (H, W, 3) over grey, and the pixels (H, W) of its mask."""

    camera: Camera
    photograph: Image
    mask: NDArray[np.bool_] | None


@dataclass(frozen=True)
class Protocol:
    """What the pictures depend on, beside the asset and the capture.

    Attributes
    ----------
    supersample : int
        Samples along each side of a pixel.
    background : (3,) floats
        The colour behind the asset, and outside the masks of the photographs.
    """

    supersample: int = 4
    background: tuple[float, float, float] = GREY

    def to_dict(self) -> dict[str, Any]:
        """Return the protocol as JSON data."""
        return {
            "name": "msb.score.protocol/1",
            "colors": "unlit, as stored",
            "samples": self.supersample**2,
            "background": list(self.background),
            "views": "held out",
            "exposure": "gain and offset per photograph and channel, for psnr_exposure only",
            "averages": "mean over views",
            "version": __version__,
        }

    @property
    def sha256(self) -> str:
        """The hash of the protocol, which includes the version of the code."""
        return hashlib.sha256(json.dumps(self.to_dict()).encode()).hexdigest()


class Capture:
    """A capture as the protocol reads it; the split is the one of `msb run`.

    Attributes
    ----------
    scene : Scene
        The scene, whose background is that of the protocol.
    protocol : Protocol
    cameras : list of Camera
        All views, sorted by name.
    """

    def __init__(self, path: Path, protocol: Protocol | None = None, **rules: Any) -> None:
        self.path, self.protocol = path, protocol or Protocol()
        scene = read_scene(path, **rules)
        if not scene.test:
            raise SceneError(
                "SCENE_LAYOUT", "it has no held-out photographs to score an asset with", file=path
            )
        self.scene: Scene = replace(scene, background=self.protocol.background)
        self.cameras = sorted((*scene.train, *scene.test), key=lambda camera: str(camera.name))

    def read(self, camera: Camera) -> TestView:
        """Return the photograph of a camera, and its mask."""
        photograph = ground_truth(self.scene, camera)
        if self.scene.mask_source is None:
            return TestView(camera, photograph, None)
        # Black and white behind the mask differ by the transparency of a pixel.
        black, white = (
            ground_truth(replace(self.scene, background=color), camera) for color in ((0.0,) * 3, (1.0,) * 3)
        )
        return TestView(camera, photograph, (white - black).mean(axis=2) < 0.5)

    @cached_property
    def test(self) -> list[TestView]:
        """The held-out views."""
        return [self.read(camera) for camera in self.scene.test]

    def photographs(self, step: Callable[[], None] = lambda: None) -> list[Photograph]:
        """Return at most `MOST_PHOTOGRAPHS` photographs with their features, spread evenly over all views.

        The asset may use all photographs for its pose, because the pose has only seven numbers.
        """
        found = self._searched
        for number in spread_numbers(len(self.cameras), MOST_PHOTOGRAPHS):
            if number not in found:
                found[number] = self._search(self.read(self.cameras[number]))
            step()
        return [found[number] for number in sorted(found)]

    @cached_property
    def _searched(self) -> dict[int, Photograph]:
        return {}

    def _search(self, view: TestView) -> Photograph:
        """Return the features of a photograph at the searched size."""
        import cv2

        camera, image, mask = view.camera, view.photograph, view.mask
        longest = max(camera.width, camera.height)
        factor = min(1.0, _SEARCHED / longest) if longest > _SEARCHED / 2 else 2.0
        if factor != 1:
            camera = camera.scaled(factor)
            size = camera.width, camera.height
            method = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
            image = np.asarray(cv2.resize(image, size, interpolation=method), np.float32)
            if mask is not None:
                mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        scale = camera.width / view.camera.width
        return Photograph(camera, detect_features(image, _FEATURES, mask), scale)

    @cached_property
    def sha256(self) -> str:
        """The hash of the held-out photographs, their masks and cameras."""
        about: list[Any] = []
        for camera in self.scene.test:
            paths = (camera.image_path, self.scene.masks.get(str(camera.name)))
            files = [file_sha256(path) for path in paths if path is not None]
            lens = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
            about.append([camera.name, *lens, camera.world_to_camera.tolist(), files])
        return hashlib.sha256(json.dumps(about).encode()).hexdigest()
