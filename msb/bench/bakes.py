"""Bakes of a run's models: made once a model and scene, then known by their hashes, as exports are.

A bake lies in the results folder beside its facts, and is made again only if one of its inputs changed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msb.asset.settings import with_settings
from msb.base.atomic import new_file
from msb.base.files import file_sha256
from msb.base.version import __version__
from msb.bench.checked import Record, checked, read_json
from msb.bench.digest import describe_file, digest, stamp
from msb.bench.documents import BakeDocument
from msb.bench.folder import Results, check_run
from msb.bench.models import Model, stored_size
from msb.bench.parts import mask_files
from msb.bench.photographs import Views, checked_scene, numbers_of
from msb.bench.protocol_tables import BakeTable
from msb.bench.records import File
from msb.errors import MsbError
from msb.registry import lookup
from msb.scenes.datasets import Scene, SceneAt

_MAX_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class BakeTask:
    """The order to a worker to make one bake of a model on a scene."""

    root: Path
    run: str
    # Dataset, scene and model, as tables name it.
    names: tuple[str, str, str]
    model: Model
    label: str
    # Those of `bake_options`.
    options: Mapping[str, Any]
    # Values that replace the model's settings where it teaches.
    settings: Mapping[str, Any]
    scene: SceneAt
    # The state of the test views when the run was planned.
    views: Views
    # A hash of all that decides the bake.
    key: str
    device: str | None = None

    @property
    def name(self) -> str:
        """What progress shows."""
        return " ".join((*self.names, self.label))

    @property
    def path(self) -> Path:
        """The baked asset's."""
        return Results(self.root).bake(*self.names, self.label)

    @property
    def facts(self) -> Path:
        """The file beside it that says what it is."""
        return self.path.with_suffix(".json")


def bake_options(table: BakeTable, method: str) -> dict[str, Any]:
    """Return what `msb.bake` takes: photographs teach where the method has no look but the plain one."""
    has_look = lookup(method).supports("dedicated")
    return {"teacher": "dedicated" if has_look else "photographs", **table.options}


def bake_key(
    model: Model, options: Mapping[str, Any], settings: Mapping[str, Any], scene: Scene, views: Views
) -> str:
    """Return a hash of all that decides a bake.

    The test views are of it since its numbers are, and photographs where they teach.
    """
    taught = [numbers_of(camera) for camera in scene.train]
    photographs = scene.train if options["teacher"] == "photographs" else ()
    masks = mask_files(scene) if photographs and scene.mask_source == "mask_folder" else ()
    paths = (*(camera.image_path for camera in photographs), *masks)
    hashes = [file_sha256(path) for path in paths if path is not None and Path(path).is_file()]
    asset = model.asset.sha256
    tests = [views.cameras, views.photographs]
    return digest([__version__, asset, dict(options), dict(settings), taught, hashes, tests])


def known_bake(task: BakeTask, run: str | None = None) -> Model | None:
    """Return the bake that was made, in a certain `run` if one is given.

    None if there is none or one of its inputs or its file changed.
    """
    try:
        path = task.facts
        facts = checked(_Facts, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")
        if facts.key != task.key or run not in (None, facts.run):
            return None
        # Results that were moved are the same: what took minutes is worth a look into the file.
        same = stamp(task.path) == facts.stamp or file_sha256(task.path) == facts.asset.sha256
    except (MsbError, OSError, ValueError):  # the last where a path holds a NUL
        return None
    return _model(task, facts) if same else None


def make_bake(task: BakeTask) -> Model:
    """Make the task's bake, taught by the training views of the scene alone, and note its facts.

    One that this run has made is taken: a cluster whose worker died may ask twice.
    """
    from msb.bake import bake

    check_run(task.root, task.run)
    if (made := known_bake(task, task.run)) is not None:
        return made
    scene = checked_scene(task.scene, task.views)
    source = with_settings(task.model.open(), task.settings)
    baked = bake(source, scene=scene, device=task.device, **task.options)
    check_run(task.root, task.run)  # a cluster's worker outlives a run that is killed, and the next may write
    report = baked.save(task.path, overwrite=True)
    held = describe_file(task.path).model_copy(update={"bytes": stored_size(task.path)})
    document = BakeDocument.of(report.to_dict())
    facts = _Facts(key=task.key, run=task.run, stamp=stamp(task.path), asset=held, bake=document)
    with new_file(task.facts) as file:
        file.write(facts.to_json())
    return _model(task, facts)


class _Facts(Record):
    """What is known of a bake, in the file beside it."""

    key: str
    run: str = ""
    stamp: tuple[str, int, int]
    asset: File
    bake: BakeDocument


def _model(task: BakeTask, facts: _Facts) -> Model:
    """Return the task's model as the bake, which is trained and evaluated as the model is."""
    asset = facts.asset.model_copy(update={"path": str(task.path)})
    return task.model.model_copy(update={"asset": asset, "source": task.model.asset, "bake": facts.bake})
