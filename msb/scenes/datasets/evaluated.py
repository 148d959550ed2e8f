"""How a scene counts in the benchmark: at which size, through which camera and over which colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from msb.scenes.datasets.read import read_scene
from msb.scenes.datasets.rulebook import OURS, RULES, evaluation_background

if TYPE_CHECKING:
    from msb.scenes.colors import Color
    from msb.scenes.datasets.rules import Convention
    from msb.scenes.datasets.scene import Scene


@dataclass(frozen=True)
class SceneAt:
    """A scene on which a method is evaluated: the arguments of `read_scene`, and its name in the results."""

    dataset: str
    name: str
    path: Path
    image_folder: str | None
    resolution: int | None
    background: Color
    camera_convention: Convention

    def read(self) -> Scene:
        """Return the scene; the last few are kept."""
        return _read(self)


def scene_at(
    path: Path,
    dataset: str,
    method: str,
    *,
    own_background: Color | None = None,
    image_folder: str | None = None,
    resolution: int | None = None,
    background: Color | None = None,
    camera_convention: Convention | None = None,
) -> SceneAt:
    """Return how a method is evaluated on a scene; `msb run` and `msb render --scene` both ask here.

    Parameters
    ----------
    path : Path
        The scene's folder. Nothing of it is read.
    dataset, method : str
    own_background : (float, float, float), optional
        The background of the method's official evaluation, if the model records it.
    image_folder, resolution, background, camera_convention
        What is asked for instead of the rules, as for `read_scene`. Without it, the size is that of our
        rules, the camera is the one the method is trained with, and the background that of
        `evaluation_background`.
    """
    return SceneAt(
        dataset=dataset,
        name=path.name,
        path=path,
        image_folder=image_folder,
        resolution=resolution,
        background=background or evaluation_background(dataset, method, own_background),
        camera_convention=camera_convention or RULES.get(method, RULES[OURS]).convention,
    )


@lru_cache(maxsize=8)
def _read(scene: SceneAt) -> Scene:
    return read_scene(
        scene.path,
        dataset=scene.dataset,
        image_folder=scene.image_folder,
        resolution=scene.resolution,
        camera_convention=scene.camera_convention,
        background=scene.background,
    )
