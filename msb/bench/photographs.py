"""Scenes of a run: read, hashed, and their photographs written once as they are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from msb.atomic import new_folder
from msb.bench.digest import digest, file_sha256
from msb.bench.folder import Results, check_run
from msb.bench.ground_truth import ground_truth
from msb.bench.records import Setup
from msb.errors import UsageError
from msb.render.images import image_names, write_image
from msb.scenes.datasets import Scene, read_scene

if TYPE_CHECKING:
    from pathlib import Path

    from msb.scenes import Camera


@dataclass(frozen=True)
class SceneAt:
    """A scene as one method is evaluated on it: what `read_scene` needs, and its name in the results."""

    dataset: str
    name: str
    path: Path
    image_folder: str | None
    resolution: int | None
    background: tuple[float, float, float]
    camera_convention: Literal["gs_fov", "full_K"]

    def read(self) -> Scene:
        """Return the scene; the last few are kept.

        Raises
        ------
        InputError, SceneError
        """
        return _read(self)


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


@dataclass(frozen=True)
class Views:
    """What the test views of a scene are: all that decides a comparison, as hashes.

    Attributes
    ----------
    cameras : str
        Of names, sizes, intrinsics and poses.
    photographs : str
        Of files, sizes, masks and background: the name of the folder with the ground truth.
    setup : Setup
    """

    cameras: str
    photographs: str
    setup: Setup


def views_of(scene: Scene) -> Views:
    """Return the state of a scene's test views; reads every test photograph once.

    Raises
    ------
    InputError
        FILE_NOT_FOUND or FILE_UNREADABLE.
    """
    files = [(str(camera.name), _hashes(scene, camera)) for camera in scene.test]
    rules = [
        list(scene.background),
        scene.compositing,
        scene.mask_source,
        scene.resampling,
        scene.quantized,
        [(camera.width, camera.height) for camera in scene.test],
    ]
    return Views(
        cameras=digest([_numbers(camera) for camera in scene.test]),
        photographs=digest([files, rules]),
        setup=Setup(
            camera_convention=scene.camera_convention,
            image_folder=scene.image_folder,
            gt_resized=scene.gt_resized,
            background=scene.background,
            mask_source=scene.mask_source,
        ),
    )


def _hashes(scene: Scene, camera: Camera) -> list[str]:
    paths = [camera.image_path, scene.masks.get(str(camera.name))]
    return [file_sha256(path) for path in paths if path is not None]


def _numbers(camera: Camera) -> list[object]:
    pose = camera.world_to_camera.tolist()
    lens = [camera.fx, camera.fy, camera.cx, camera.cy]
    return [camera.name, camera.width, camera.height, *lens, pose]


@dataclass(frozen=True)
class PhotographTask:
    """The ground truth of a scene to be written, as a worker gets it."""

    root: Path
    run: str
    scene: SceneAt
    views: Views

    @property
    def name(self) -> str:
        """What progress shows."""
        return f"{self.scene.dataset} {self.scene.name}"

    @property
    def folder(self) -> Path:
        """Where it is written."""
        return Results(self.root).ground_truth(self.scene.dataset, self.scene.name, self.views.photographs)


def write_photographs(task: PhotographTask) -> None:
    """Write the test photographs as they are compared, named as renderings are; nothing if they are there.

    Raises
    ------
    UsageError
        RUN_WORKER_PATHS: this machine sees another scene under that path.
    InputError, SceneError, MetricError, OutputError
    """
    check_run(task.root, task.run)
    if task.folder.is_dir():
        return
    scene = checked_scene(task.scene, task.views)
    with new_folder(task.folder) as folder:
        for name, camera in zip(image_names(scene.test), scene.test, strict=True):
            write_image(folder / f"{name}.png", ground_truth(scene, camera), "png")


def checked_scene(at: SceneAt, views: Views) -> Scene:
    """Return the scene, if its cameras are those the run was planned with.

    Raises
    ------
    UsageError
        RUN_WORKER_PATHS.
    InputError, SceneError
    """
    scene = at.read()
    if digest([_numbers(camera) for camera in scene.test]) != views.cameras:
        text = "its cameras are not those the run was planned with: changed since, or another folder here"
        raise UsageError("RUN_WORKER_PATHS", text, file=at.path)
    return scene
