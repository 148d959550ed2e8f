"""A scene's model as an asset: exported and hashed once, then known by size and time of its files."""

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
from msb.bench.checked import Record, checked, read_json
from msb.bench.digest import describe_file, digest, list_sha256, stamp
from msb.bench.documents import BakeDocument
from msb.bench.folder import Results, check_run
from msb.bench.protocol_tables import AUTO
from msb.bench.records import File
from msb.errors import CheckpointError, MsbError
from msb.scenes.datasets import stated_background

_MAX_BYTES = 1 << 20


class Model(Record):
    """An asset of the run, and the model that it was made from."""

    method: str
    checkpoint: File | None
    """The model's own file; for several files the hash of their list of hashes."""
    asset: File
    """Its `bytes` is the sum of the sizes of the files in the container."""
    background: tuple[float, float, float] | None
    """That of the method's official evaluation, if the checkpoint records it."""
    training: dict[str, Any]
    """The manifest's key of that name."""
    stamps: tuple[tuple[str, int, int], ...]
    """Of all files of source and asset; while these are unchanged, the hashes are valid."""
    key: str
    """Path and method as the protocol gives them."""
    warnings: tuple[str, ...] = ()
    """The assumptions that the export had to make."""
    source: File | None = None
    """The asset that a bake was made of; the bake's own is `asset`."""
    bake: BakeDocument | None = None

    def open(self) -> Asset:
        """Return the asset."""
        return load(self.asset.path)


@dataclass(frozen=True)
class ModelTask:
    """The order to a worker to make one model ready."""

    root: Path
    run: str
    dataset: str
    scene: str
    method: str
    source: Path
    label: str | None = None

    @property
    def name(self) -> str:
        """What progress shows."""
        return f"{self.dataset} {self.scene} {self.label or self.method}"


def known_model(results: Results, task: ModelTask) -> Model | None:
    """Return the recorded facts about a model, None if there are none or a file has changed since."""
    try:
        path = _record(results, task)
        model = checked(Model, read_json(path, _MAX_BYTES), file=path, code="RECORD_INVALID")
        # The model is looked for again: a training may have written a later iteration.
        current = model.key == _key(task) and all(
            stamp(Path(path)) == (path, *rest) for path, *rest in model.stamps
        )
        return model if current and _source_file(task) in {path for path, *_ in model.stamps} else None
    except (MsbError, OSError, ValueError):  # the last where a path holds a NUL
        return None


def prepare_model(task: ModelTask) -> Model:
    """Return the task's model: the recorded one, or its checkpoint exported into the results folder."""
    results = Results(task.root)
    check_run(task.root, task.run)
    known = known_model(results, task)
    if known is not None:
        return known
    source = task.source
    if is_asset(source):
        asset, path, files = load(source), source, []
        if task.method not in (AUTO, asset.manifest.method):
            text = f"it holds a {asset.manifest.method} model; the protocol says {task.method}"
            raise CheckpointError("CHECKPOINT_METHOD", text, file=source)
    else:
        read = read_model(source, method=None if task.method == AUTO else task.method)
        asset, files = finish(read), list(read.files)
        path = results.asset(task.dataset, task.scene, task.label or asset.manifest.method)
        write_asset(asset, path)
    held = describe_file(path)
    model = Model(
        method=asset.manifest.method,
        checkpoint=_checkpoint(asset, source),
        asset=held.model_copy(update={"bytes": stored_size(path)}),
        background=stated_background(asset.manifest),
        training=asset.manifest.training,
        stamps=tuple(stamp(file) for file in (*files, *_files(path))),
        key=_key(task),
        warnings=tuple(warning.to_line(source) for warning in asset.warnings),
    )
    with new_file(_record(results, task)) as file:
        file.write(model.to_json())
    return model


def method_of(source: Path) -> str:
    """Return the method of the model at `source`, without exporting it."""
    return load(source).manifest.method if is_asset(source) else detect(source)


def _record(results: Results, task: ModelTask) -> Path:
    name = f"{task.label or task.method}-{digest(_key(task))[:8]}.json"
    return results.asset(task.dataset, task.scene, task.method).with_name(name)


def _key(task: ModelTask) -> str:
    return json.dumps([str(task.source), task.method])


def _source_file(task: ModelTask) -> str:
    """Return the file that decides what the model is."""
    if is_asset(task.source):
        return str(_files(task.source)[0])
    return str(locate(task.source).file)


def _files(asset: Path) -> list[Path]:
    if not asset.is_dir():
        return [asset]
    return [asset / MANIFEST_NAME, *sorted((asset / "buffers").glob("*"))]


def stored_size(asset: Path) -> int:
    """Return the bytes of the files in a container of either form."""
    if asset.is_dir():
        return sum(file.stat().st_size for file in _files(asset))
    with zipfile.ZipFile(asset) as container:
        return sum(item.file_size for item in container.infolist())


def _checkpoint(asset: Asset, source: Path) -> File | None:
    """Return the model's own files as the asset's manifest records them."""
    files = asset.manifest.source.files
    if not files:
        return None
    hashes = [(file.path, file.sha256) for file in files]
    sha256 = hashes[0][1] if len(hashes) == 1 else list_sha256(hashes)
    return File(path=str(source), bytes=sum(file.byte_length for file in files), sha256=sha256)
