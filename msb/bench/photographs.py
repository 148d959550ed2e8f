"""The state of a scene's test views, and the ground truth: photographs prepared for comparison.

The ground truth is written once per scene: photographs that are resized, masked and rounded to bytes, with a
list of hashes. Every run verifies the ground truth against this list, because a damaged image would falsify
all later results.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from msb.base.atomic import new_file, new_folder
from msb.base.files import file_sha256
from msb.bench.digest import digest
from msb.bench.folder import Results, check_run
from msb.bench.records import Setup
from msb.bench.validation import read_json
from msb.errors import MsbError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.render.images import image_names, write_image
from msb.scenes import Camera
from msb.scenes.datasets import Scene, SceneAt

# Name of the hash list in every folder of ground truth. The file contains the hash of the sources, and the
# SHA-256 of each image.
HASHES = "hashes.json"
SCHEMA = "msb.ground_truth/1"
# Maximum size of the hash list in bytes.
_MAX_BYTES = 64 << 20


@dataclass(frozen=True)
class ViewState:
    """The state of a scene's test views: hashes of all data that affects a comparison."""

    # Hash of the names, sizes, intrinsics and poses of the cameras.
    cameras: str
    # Hash of photographs, sizes, masks and background. The ground truth folder is named after this hash.
    photographs: str
    setup: Setup
    # Names without suffix that photographs, renderings and ground truth share.
    names: tuple[str, ...]


def describe_views(scene: Scene) -> ViewState:
    """Return the state of a scene's test views. Every test photograph is read once."""
    files = [(str(camera.name), _hash_sources(scene, camera)) for camera in scene.test]
    # Add the scene's settings that affect the ground truth.
    rules: list[object] = [
        list(scene.background),
        scene.compositing,
        scene.mask_source,
        scene.resampling,
        scene.quantized,
        [(camera.width, camera.height) for camera in scene.test],
    ]
    # Add the rotated and undistorted photographs to the hash. If no photograph is rotated or undistorted,
    # keep the hash of earlier versions.
    if readings := [
        _describe_reading(scene, camera) for camera in scene.test if camera.name in scene.readings
    ]:
        rules.append(readings)
    return ViewState(
        cameras=digest([describe_camera(camera) for camera in scene.test]),
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


def _describe_reading(scene: Scene, camera: Camera) -> list[object]:
    """Return the orientation and the undistortion of a photograph as JSON data."""
    reading = scene.readings[str(camera.name)]
    lens, about = reading.lens, list[object]((camera.name, reading.orientation))
    if lens is None or lens.distortion is None:
        return about
    return [*about, describe_camera(lens), lens.distortion.model, *lens.distortion.coefficients]


def _hash_sources(scene: Scene, camera: Camera) -> list[str]:
    paths = [camera.image_path, scene.masks.get(str(camera.name))]
    return [file_sha256(path) for path in paths if path is not None]


def describe_camera(camera: Camera) -> list[object]:
    """Return name, size, intrinsics and pose of a camera as JSON data."""
    pose = camera.world_to_camera.tolist()
    lens = [camera.fx, camera.fy, camera.cx, camera.cy]
    return [camera.name, camera.width, camera.height, *lens, pose]


@dataclass(frozen=True)
class PhotographTask:
    """A task for a worker: write the ground truth of a scene."""

    root: Path
    run: str
    scene: SceneAt
    views: ViewState

    @property
    def name(self) -> str:
        """The name of the task in progress lines."""
        return f"{self.scene.dataset} {self.scene.name}"

    @property
    def folder(self) -> Path:
        """The folder of the ground truth."""
        return Results(self.root).ground_truth(self.scene.dataset, self.scene.name, self.views.photographs)


def write_photographs(task: PhotographTask) -> str | None:
    """Write the ground truth of a scene. If valid ground truth exists, keep it.

    Invalid ground truth is written again, and the reason is returned as text.
    """
    check_run(task.root, task.run)
    exists = task.folder.is_dir()
    fault = _find_fault(task.folder, task.views) if exists else None
    if exists and fault is None:
        return None
    scene = read_planned_scene(task.scene, task.views)
    with new_folder(task.folder) as folder:
        for name, camera in zip(task.views.names, scene.test, strict=True):
            write_image(folder / f"{name}.png", ground_truth(scene, camera), "png")
        document = _make_document(task.views, _hash_files_below(folder))
        with new_file(folder / HASHES) as file:
            file.write(json.dumps(document, indent=1).encode() + b"\n")
    return fault


def _make_document(views: ViewState, files: Mapping[str, str]) -> dict[str, object]:
    return {"schema": SCHEMA, "photographs": views.photographs, "files": files}


def _find_fault(folder: Path, views: ViewState) -> str | None:
    """Compare the ground truth with its list of hashes. Return the first difference, or None."""
    try:
        about = read_json(folder / HASHES, _MAX_BYTES)
        present = _hash_files_below(folder)
    except MsbError as error:
        return f"{Path(str(error.file)).name}: {error.message}"
    files = about.get("files") if isinstance(about, dict) else None
    names = {f"{name}.png" for name in views.names}
    if not isinstance(files, dict) or about != _make_document(views, files) or set(files) != names:
        return f"{HASHES} belongs to other photographs"
    # Ignore hidden files that file managers create.
    others = {name for name in present if not Path(name).name.startswith(".")}
    for name in sorted(names | others):
        if present.get(name) != files.get(name):
            fault = (
                "is missing" if name not in present else "was changed" if name in names else "is unexpected"
            )
            return f"{name} {fault}"
    return None


def _hash_files_below(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder, as a mapping from file name to hash. The hash list
    itself is left out.

    If a folder is in place of a file, its hash is "".
    """
    files = (Path(root, name) for root, _, names in os.walk(folder) for name in names)
    return {
        file.relative_to(folder).as_posix(): file_sha256(file) if file.is_file() else ""
        for file in sorted(files)
        if file != folder / HASHES
    }


def read_planned_scene(at: SceneAt, views: ViewState) -> Scene:
    """Return a scene. Raise RUN_SCHEDULER if the cameras have changed since the run was planned."""
    scene = at.read()
    if digest([describe_camera(camera) for camera in scene.test]) != views.cameras:
        text = (
            "the cameras changed since the run was planned, or this machine has another scene under this path"
        )
        raise UsageError("RUN_SCHEDULER", text, file=at.path)
    return scene
