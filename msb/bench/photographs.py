"""The scenes of a run, which are read and hashed, and their photographs, written once as they are compared.

Beside the copies lies a list of their hashes and of what they were made from. At the start of every run they
are read and compared with that list, because a changed or damaged copy would make every later number wrong.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from msb.base.atomic import new_file, new_folder
from msb.base.files import file_sha256
from msb.bench.checked import read_json
from msb.bench.digest import digest
from msb.bench.folder import Results, check_run
from msb.bench.records import Setup
from msb.errors import MsbError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.render.images import image_names, write_image
from msb.scenes import Camera
from msb.scenes.datasets import Scene, SceneAt

# The file in every folder of ground truth that says what it was made from, and the SHA-256 of each file.
HASHES = "hashes.json"
SCHEMA = "msb.ground_truth/1"
_MAX_BYTES = 64 << 20


@dataclass(frozen=True)
class Views:
    """The state of a scene's test views: everything that decides a comparison, as hashes."""

    # Of names, sizes, intrinsics and poses.
    cameras: str
    # Of files, sizes, masks and background; it names the folder with the ground truth.
    photographs: str
    setup: Setup
    # The names of the images without suffix, which renderings and ground truth have, too.
    names: tuple[str, ...]


def views_of(scene: Scene) -> Views:
    """Return the state of a scene's test views; reads every test photograph once."""
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
        cameras=digest([numbers_of(camera) for camera in scene.test]),
        photographs=digest([files, rules]),
        setup=Setup(
            camera_convention=scene.camera_convention,
            image_folder=scene.image_folder,
            gt_resized=scene.gt_resized,
            background=scene.background,
            mask_source=scene.mask_source,
        ),
        names=tuple(image_names(scene.test)),
    )


def _hashes(scene: Scene, camera: Camera) -> list[str]:
    paths = [camera.image_path, scene.masks.get(str(camera.name))]
    return [file_sha256(path) for path in paths if path is not None]


def numbers_of(camera: Camera) -> list[object]:
    """Return all that decides what a camera sees, and its name, as JSON data."""
    pose = camera.world_to_camera.tolist()
    lens = [camera.fx, camera.fy, camera.cx, camera.cy]
    return [camera.name, camera.width, camera.height, *lens, pose]


@dataclass(frozen=True)
class PhotographTask:
    """The order to a worker to write the ground truth of a scene."""

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
        """The folder that the ground truth is written to."""
        return Results(self.root).ground_truth(self.scene.dataset, self.scene.name, self.views.photographs)


def write_photographs(task: PhotographTask) -> str | None:
    """Write the test photographs as they are compared, with the names of renderings, unless they exist.

    Existing files are read and must be those that were written. Otherwise all of them are written again, and
    what was wrong is returned.
    """
    check_run(task.root, task.run)
    there = task.folder.is_dir()
    wrong = _what_differs(task.folder, task.views) if there else None
    if there and wrong is None:
        return None
    scene = checked_scene(task.scene, task.views)
    with new_folder(task.folder) as folder:
        for name, camera in zip(task.views.names, scene.test, strict=True):
            write_image(folder / f"{name}.png", ground_truth(scene, camera), "png")
        about = _about(task.views, _hashes_below(folder))
        with new_file(folder / HASHES) as file:
            file.write(json.dumps(about, indent=1).encode() + b"\n")
    return wrong


def _about(views: Views, files: Mapping[str, str]) -> dict[str, object]:
    return {"schema": SCHEMA, "photographs": views.photographs, "files": files}


def _what_differs(folder: Path, views: Views) -> str | None:
    """Return what is not as it was written, None if everything is."""
    try:
        about = read_json(folder / HASHES, _MAX_BYTES)
        present = _hashes_below(folder)
    except MsbError as error:
        return f"{Path(str(error.file)).name}: {error.message}"
    files = about.get("files") if isinstance(about, dict) else None
    names = {f"{name}.png" for name in views.names}
    if not isinstance(files, dict) or about != _about(views, files) or set(files) != names:
        return f"{HASHES} is not of these photographs"
    # What systems hide in folders that are looked at is no harm.
    others = {name for name in present if not Path(name).name.startswith(".")}
    for name in sorted(names | others):
        if present.get(name) != files.get(name):
            how = "is gone" if name not in present else "was changed" if name in names else "is none of them"
            return f"{name} {how}"
    return None


def _hashes_below(folder: Path) -> dict[str, str]:
    """Return name -> SHA-256 of all files below but the list itself; "" of what is none."""
    files = (Path(root, name) for root, _, names in os.walk(folder) for name in names)
    return {
        file.relative_to(folder).as_posix(): file_sha256(file) if file.is_file() else ""
        for file in sorted(files)
        if file != folder / HASHES
    }


def checked_scene(at: SceneAt, views: Views) -> Scene:
    """Return the scene, if its cameras are those with which the run was planned."""
    scene = at.read()
    if digest([numbers_of(camera) for camera in scene.test]) != views.cameras:
        text = "its cameras are not those the run was planned with: changed since, or another folder here"
        raise UsageError("RUN_SCHEDULER", text, file=at.path)
    return scene
