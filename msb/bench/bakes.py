"""The bakes of a run. A bake is computed once per model and scene, and again only if an input changes.

A bake is stored in the results folder. A JSON file beside the bake stores the report of the bake and a hash
of its inputs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msb.asset.settings import with_settings
from msb.base.atomic import new_file
from msb.base.files import file_sha256
from msb.base.version import __version__
from msb.bench.digest import describe_file, digest, stamp
from msb.bench.documents import BakeDocument
from msb.bench.folder import Results, check_run
from msb.bench.models import ModelAsset, measure_size
from msb.bench.photographs import ViewState, describe_camera, read_planned_scene
from msb.bench.protocol_tables import BakeTable
from msb.bench.records import File
from msb.bench.validation import Record, read_json, validate
from msb.errors import MsbError
from msb.registry import lookup
from msb.scenes.datasets import Scene, SceneAt

# Maximum size in bytes of the JSON file that describes a bake.
_MAX_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class BakeTask:
    """A task for a worker process: bake one model on a scene."""

    root: Path
    run: str
    # Dataset, scene and model of the bake.
    names: tuple[str, str, str]
    model: ModelAsset
    label: str
    # Bake options, the result of `make_bake_options`.
    options: Mapping[str, Any]
    # Values that replace the model's settings in native rendering.
    settings: Mapping[str, Any]
    scene: SceneAt
    # Hashes of the test views when the run was planned.
    views: ViewState
    # The hash of all inputs of the bake.
    key: str
    device: str | None = None

    @property
    def name(self) -> str:
        """The name of the task in progress lines."""
        return " ".join((*self.names, self.label))

    @property
    def path(self) -> Path:
        """The path of the baked asset."""
        return Results(self.root).bake(*self.names, self.label)

    @property
    def description_path(self) -> Path:
        """The path of the JSON file that describes the bake."""
        return self.path.with_suffix(".json")


def make_bake_options(table: BakeTable, method: str) -> dict[str, Any]:
    """Return the options of `msb.bake`. By default, the method's native rendering supervises the bake.

    A mesh without a method's renderer is supervised by photographs.
    """
    is_native = lookup(method).supports("dedicated")
    return {"supervision": "native" if is_native else "photographs", **table.options}


def hash_bake_inputs(
    model: ModelAsset,
    options: Mapping[str, Any],
    settings: Mapping[str, Any],
    scene: Scene,
    views: ViewState,
) -> str:
    """Return a hash of the inputs of a bake.

    The test views are inputs because the report of the bake is measured on them. Training photographs and
    masks are inputs only if they supervise the bake.
    """
    training = [describe_camera(camera) for camera in scene.train]
    photographs = scene.train if options["supervision"] == "photographs" else ()
    masks = [scene.masks.get(str(camera.name)) for camera in photographs]
    paths = (*(camera.image_path for camera in photographs), *masks)
    hashes = [file_sha256(path) for path in paths if path is not None and Path(path).is_file()]
    asset = model.asset.sha256
    tests = [views.cameras, views.photographs]
    return digest([__version__, asset, dict(options), dict(settings), training, hashes, tests])


def find_known_bake(task: BakeTask, run: str | None = None) -> ModelAsset | None:
    """Return the finished bake of a task, or None if it is missing, outdated or damaged.

    If `run` is given, only a bake of this run is returned.
    """
    try:
        path = task.description_path
        description = validate(
            _BakeDescription, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID"
        )
        if description.key != task.key or run not in (None, description.run):
            return None
        # Copying the results folder changes the modification time. If the time differs, the file content is
        # compared.
        same = stamp(task.path) == description.stamp or file_sha256(task.path) == description.asset.sha256
    except (MsbError, OSError, ValueError):  # ValueError: the path contains a NUL character
        return None
    return _make_model(task, description) if same else None


def make_bake(task: BakeTask) -> ModelAsset:
    """Bake the model of a task from the training views of the scene, and write the JSON file of the bake.

    If this run has already finished the bake, it is returned without computation. A task can arrive twice,
    because a cluster may repeat the tasks of a lost worker.
    """
    from msb.bake import bake

    check_run(task.root, task.run)
    if (known := find_known_bake(task, task.run)) is not None:
        return known
    scene = read_planned_scene(task.scene, task.views)
    source = with_settings(task.model.open(), task.settings)
    baked = bake(source, scene=scene, device=task.device, **task.options)
    check_run(task.root, task.run)  # stop this task if a later run has started
    report = baked.save(task.path, overwrite=True)
    asset = describe_file(task.path).model_copy(update={"bytes": measure_size(task.path)})
    document = BakeDocument.of(report.to_dict())
    description = _BakeDescription(
        key=task.key, run=task.run, stamp=stamp(task.path), asset=asset, bake=document
    )
    with new_file(task.description_path) as file:
        file.write(description.to_json())
    return _make_model(task, description)


class _BakeDescription(Record):
    """The content of the JSON file that describes a bake."""

    key: str
    run: str = ""
    stamp: tuple[str, int, int]
    asset: File
    bake: BakeDocument


def _make_model(task: BakeTask, description: _BakeDescription) -> ModelAsset:
    """Return a model whose asset is the baked mesh."""
    asset = description.asset.model_copy(update={"path": str(task.path)})
    return task.model.model_copy(
        update={"asset": asset, "source": task.model.asset, "bake": description.bake}
    )
