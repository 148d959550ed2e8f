"""The models of a run, exported as assets. If a file changes, the model is exported again."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msb.adapters.exporter import detect, finish, read_model
from msb.adapters.locate import locate
from msb.asset import Asset, is_asset, load, write_asset
from msb.asset.manifest import MANIFEST_NAME
from msb.base.atomic import new_file
from msb.bench.digest import describe_file, digest, list_sha256, stamp
from msb.bench.documents import BakeDocument
from msb.bench.folder import Results, check_run
from msb.bench.protocol_tables import AUTO
from msb.bench.records import File
from msb.bench.validation import Record, read_json, validate
from msb.errors import CheckpointError, MsbError
from msb.scenes.datasets import stated_background

# Maximum size in bytes of the JSON file that describes a model.
_MAX_BYTES = 1 << 20


class ModelAsset(Record):
    """An asset of a run, and the model that was exported to this asset."""

    method: str
    # The main file of the checkpoint. If a checkpoint has several files, the hash is computed from the list
    # of the files' hashes.
    checkpoint: File | None
    # The exported asset; `bytes` is the total size of its files.
    asset: File
    # Background colour of the official evaluation, if the checkpoint records it.
    background: tuple[float, float, float] | None
    # The section `training` of the manifest.
    training: dict[str, Any]
    # Path, size and modification time of all files of the checkpoint and the asset. The hashes are valid
    # while path, size and time are unchanged.
    stamps: tuple[tuple[str, int, int], ...]
    # Path and method of the model in the protocol.
    key: str
    # Warnings about assumptions made during the export.
    warnings: tuple[str, ...] = ()
    # For a bake, this is the asset before the bake, and `asset` is the baked mesh.
    source: File | None = None
    bake: BakeDocument | None = None

    def open(self) -> Asset:
        """Return the asset."""
        return load(self.asset.path)


@dataclass(frozen=True)
class ModelTask:
    """A task for a worker: export and hash one model."""

    root: Path
    run: str
    dataset: str
    scene: str
    method: str
    source: Path
    label: str | None = None

    @property
    def name(self) -> str:
        """The name of the task in progress lines."""
        return f"{self.dataset} {self.scene} {self.label or self.method}"


def find_known_model(results: Results, task: ModelTask) -> ModelAsset | None:
    """Return the recorded description of a model, or None if it is missing or if a file has changed."""
    try:
        path = _record(results, task)
        model = validate(ModelAsset, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")
        # Search the checkpoint again, because the training may have written a later iteration.
        current = model.key == _make_key(task) and all(
            stamp(Path(path)) == (path, *rest) for path, *rest in model.stamps
        )
        return model if current and _find_source_file(task) in {path for path, *_ in model.stamps} else None
    except (MsbError, OSError, ValueError):  # ValueError: the path contains a NUL character
        return None


def prepare_model(task: ModelTask) -> ModelAsset:
    """Return the model of a task. If necessary, export its checkpoint to the results folder."""
    results = Results(task.root)
    check_run(task.root, task.run)
    known = find_known_model(results, task)
    if known is not None:
        return known
    source = task.source
    if is_asset(source):
        asset, path, files = load(source), source, []
        if task.method not in (AUTO, asset.manifest.method):
            text = f"the method of this asset is {asset.manifest.method}, but the protocol has {task.method}"
            raise CheckpointError("CHECKPOINT_METHOD", text, file=source)
    else:
        checkpoint = read_model(source, method=None if task.method == AUTO else task.method)
        asset, files = finish(checkpoint), list(checkpoint.files)
        path = results.asset(task.dataset, task.scene, task.label or asset.manifest.method)
        write_asset(asset, path)
    file = describe_file(path)
    model = ModelAsset(
        method=asset.manifest.method,
        checkpoint=_describe_checkpoint(asset, source),
        asset=file.model_copy(update={"bytes": measure_size(path)}),
        background=stated_background(asset.manifest),
        training=asset.manifest.training,
        stamps=tuple(stamp(part) for part in (*files, *_list_files(path))),
        key=_make_key(task),
        warnings=tuple(warning.to_line(source) for warning in asset.warnings),
    )
    with new_file(_record(results, task)) as record:
        record.write(model.to_json())
    return model


def detect_method(source: Path) -> str:
    """Return the name of the method of the model at `source`, without exporting it."""
    return load(source).manifest.method if is_asset(source) else detect(source)


def _record(results: Results, task: ModelTask) -> Path:
    name = f"{task.label or task.method}-{digest(_make_key(task))[:8]}.json"
    return results.asset(task.dataset, task.scene, task.method).with_name(name)


def _make_key(task: ModelTask) -> str:
    return json.dumps([str(task.source), task.method])


def _find_source_file(task: ModelTask) -> str:
    """Return the path of the main file of a model."""
    if is_asset(task.source):
        return str(_list_files(task.source)[0])
    return str(locate(task.source).file)


def _list_files(asset: Path) -> list[Path]:
    """Return the files of an asset. An asset is a single file or a folder."""
    if not asset.is_dir():
        return [asset]
    return [asset / MANIFEST_NAME, *sorted((asset / "buffers").glob("*"))]


def measure_size(asset: Path) -> int:
    """Return the sum of the sizes of the files in an asset, in bytes."""
    if asset.is_dir():
        return sum(file.stat().st_size for file in _list_files(asset))
    with zipfile.ZipFile(asset) as container:
        return sum(item.file_size for item in container.infolist())


def _describe_checkpoint(asset: Asset, source: Path) -> File | None:
    """Return the checkpoint files that the manifest of the asset records."""
    files = asset.manifest.source.files
    if not files:
        return None
    hashes = [(file.path, file.sha256) for file in files]
    sha256 = hashes[0][1] if len(hashes) == 1 else list_sha256(hashes)
    return File(path=str(source), bytes=sum(file.byte_length for file in files), sha256=sha256)
