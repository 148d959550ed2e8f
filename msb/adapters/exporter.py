"""The function `msb.export`: find a model, detect its method, read it, and build an asset."""

import difflib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Protocol, cast

import numpy as np

from msb.adapters.locate import Place, locate
from msb.adapters.model import Content, Model, Options
from msb.asset import Asset, build_asset
from msb.asset.arguments import check_type
from msb.asset.drawable import check_indices
from msb.asset.finite import find_bad_faces, find_bad_rows, keep_faces
from msb.asset.manifest import Source, SourceFile
from msb.asset.progress import Meter, Progress
from msb.asset.settings import parse_overrides
from msb.base.files import file_sha256, is_file
from msb.base.packages import warn
from msb.base.paths import given_path
from msb.errors import CheckpointError, InputError, Unsupported, UsageError, about, finding, shorten
from msb.registry import BUILT_IN, METHODS, role, with_role


class Adapter(Protocol):
    """The functions of an adapter module, the reader of a method's files. The optional `KEYS` of an adapter
    are the keys that all state dicts of its method have."""

    def recognises(self, content: Content) -> bool:
        """Return whether the content has features that only models of this method have."""

    def read(self, place: Place, content: Content, options: Options) -> Model:
        """Return the model, or raise an error if the file is invalid."""


def adapters() -> dict[str, Adapter]:
    """Return the adapters by method in the order of detection: adapters of other packages come first.

    An adapter from another package is tried first, so it can distinguish its files from files of the built-in
    methods. The built-in adapters cannot recognise the files of other packages.
    """
    by_name = {name: adapter for name in METHODS if (adapter := _by_name(name)) is not None}
    by_name |= dict(with_role("adapter"))
    others = [name for name in by_name if name not in BUILT_IN]
    return {name: by_name[name] for name in (*others, *BUILT_IN)}


def _by_name(method: str) -> Adapter | None:
    """Return the adapter of a method whose files are recognised only by name, or None for other methods.

    Methods whose files are recognised by name have no native rendering.
    """
    known, meshes = METHODS[method], cast("Any", role("mesh", "adapter"))
    return meshes.ByName(method) if known.reads_meshes and known.native is None and known.files else None


def export(
    path: str | os.PathLike[str],
    *,
    method: str | None = None,
    settings: Mapping[str, Any] | None = None,
    config: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Asset:
    """Return the trained model at `path` as an asset, without torch and without executing code of the file.

    Parameters
    ----------
    path : path-like
        The output folder of a training, or the file of the model; docs/export.md lists the files.
    method : str, optional
        The name of a method, as listed by `msb methods`. By default, the method is detected from the content.
    settings : mapping, optional
        Values of settings by name. These settings override the config and the checkpoint.
    config : path-like, optional
        YAML config or text log of a 2DTS training, if it is not in the output folder.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` with bytes.

    Returns
    -------
    Asset
        An asset in memory. If the file layout permits, the buffers are views of the mapped file.
        `Asset.warnings` reports missing values that were replaced by defaults, and faces that are left out
        because a parameter is NaN.

    Raises
    ------
    InputError, CheckpointError, MeshFileError, AssetError
        The files are missing or invalid.
    Unsupported
        `UNSUPPORTED_METHOD`: models of this method do not consist of triangles.
    UsageError
        The method or a setting is unknown, or the method has no config.
    """
    if settings is not None:
        check_type("settings", settings, Mapping, "a mapping from names to values")
    model = read_model(path, method=method, settings=settings or {}, config=config, reject="coordinates")
    return finish(model, progress=progress)


def finish(model: Model, *, progress: Progress | None = None) -> Asset:
    """Return `model` as an asset with hashes of its sources and buffers."""
    source = Source(tuple(_source_files(model, progress)))
    description = replace(model.description, source=source)
    with about(model.files[0]):
        asset = build_asset(model.buffers, model.domains, description, progress=progress)
    return replace(asset, warnings=model.warnings, opened_from=model.opened_from)


def read_model(
    path: str | os.PathLike[str] | Place,
    *,
    method: str | None = None,
    settings: Mapping[str, Any] | Sequence[str] = (),
    config: str | os.PathLike[str] | None = None,
    check_values: bool = True,
    reject: Literal["nothing", "coordinates", "everything"] = "nothing",
) -> Model:
    """Return the trained model at `path`, or at a place returned by `locate`. The function raises the errors
    of `export`.

    `settings` can also be a sequence of texts such as "gamma=20". Faces with a NaN or infinite value are left
    out with a warning. If no face remains, the function raises an error. `reject` chooses the values that
    must be finite: coordinates, or all values. A non-finite value then raises an error instead of a warning.
    Without `check_values`, faces with non-finite values are kept, so that an audit can count them.
    """
    if method is not None and method not in tuple(METHODS):
        text = f'the method "{shorten(str(method), 40)}" is unknown; use one of {", ".join(METHODS)}'
        raise UsageError("USAGE", text)
    # Find the file of the model, and detect or check its method.
    place = path if isinstance(path, Place) else locate(path)
    content = Content(place)
    if method is None:
        method = _detect(content)
    else:
        _reject_other_method(content, method)
    # Read the model with the settings and the config of the caller.
    values = settings if isinstance(settings, Mapping) else parse_overrides(method, settings)
    config_file = None if config is None else given_path(config)
    if config_file is not None and not is_file(config_file):
        raise InputError("FILE_NOT_FOUND", "the file does not exist", file=config_file)
    is_strict = check_values and reject == "everything"
    model = _adapter(method).read(place, content, Options(values, config_file, is_strict))
    if config_file is not None and config_file not in model.files:  # the adapter has not read this config
        text = f"the method of this model, {METHODS[method].title}, does not use --config; only 2DTS does"
        raise UsageError("USAGE", text, file=config_file)
    if check_values:
        model = _without_bad_faces(model, reject)
    return replace(model, opened_from=place.given)


def _without_bad_faces(model: Model, reject: str) -> Model:
    """Return `model` without the faces whose values are not finite, with a warning about these faces.

    Raise CHECKPOINT_NONFINITE if `reject` forbids the values, or if no face remains. `build_asset` reports
    invalid coordinates of mesh files.
    """
    is_mesh = model.description.method == "mesh"
    code, file = "MESH_NONFINITE" if is_mesh else "CHECKPOINT_NONFINITE", model.files[0]
    for name, array in model.buffers.items():
        if model.domains.get(name) == "global" and (rows := find_bad_rows(array)) is not None:
            text = f"{name} is not finite in row {int(np.argmax(rows))}, which affects all faces"
            raise CheckpointError("CHECKPOINT_NONFINITE", text, file=file, pointer=name)
    check_indices(model.buffers["indices"], len(model.buffers["positions"]), file)
    bad, names = find_bad_faces(model.buffers, model.domains)
    # Unused vertices with non-finite positions are also removed, with a warning.
    is_odd = find_bad_rows(model.buffers["positions"]) is not None
    if not (len(bad) and (bad.any() or is_odd)) or reject == "everything":
        return model
    count, first = int(np.count_nonzero(bad)), int(np.argmax(bad))
    what = f"{count:,} of {len(bad):,} faces have values that are not finite ({', '.join(names)}"
    what += f"; the first such face is {first})"
    if bad.all() or (reject == "coordinates" and is_odd):
        if is_mesh:
            return model
        text = f"{what}; an asset must have finite coordinates, and at least one face"
        raise CheckpointError(code, text, file=file)
    buffers = keep_faces(model.buffers, model.domains, ~bad)
    text = f"{what}; these faces are left out" if count else "removed unused vertices that are not finite"
    warning = finding(code, text, severity="warning", value=count)
    return replace(model, buffers=buffers, warnings=(*model.warnings, warning))


def detect(path: str | os.PathLike[str]) -> str:
    """Return the method of the model at `path`."""
    return _detect(Content(locate(path)))


def _adapter(method: str) -> Adapter:
    adapter: Any = role(method, "adapter") or _by_name(method)
    if adapter is None:
        text = f"{METHODS[method].title} has no adapter that reads its models"
        raise Unsupported("UNSUPPORTED_METHOD", text)
    return cast("Adapter", adapter)


def _detect(content: Content) -> str:
    known = adapters()
    method = _recognise(content, known)
    if method is not None:
        return method
    value = content.value
    if isinstance(value, dict):
        what = "the keys of the file are " + (
            ", ".join(shorten(str(key), 30) for key in list(value)[:8]) or "none"
        )
    elif content.ply_names:
        what = "the file is a PLY without faces, with" + ", ".join(content.ply_names[:8])
    elif content.place.kind == "torch":
        what = f"the file holds a {type(value).__name__}"
    else:
        what = "the content of the file does not match the file name"
    text = f"{what}; the file is not a model of {', '.join(known)}{_describe_nearest(value, known)}"
    raise CheckpointError("CHECKPOINT_UNKNOWN", text, file=content.place.file)


def _describe_nearest(value: object, adapters_by_name: Mapping[str, Adapter]) -> str:
    """Return text about the most similar method and the keys that `value` lacks. If no method is similar,
    return ""."""
    parts = [value] if isinstance(value, dict) else value if isinstance(value, tuple) else []
    keys = {str(key) for part in parts[:1] if isinstance(part, dict) for key in part}
    keys_of = {name: set(getattr(adapter, "KEYS", ())) for name, adapter in adapters_by_name.items()}
    name = max(keys_of, key=lambda name: len(keys_of[name] & keys) / (len(keys_of[name]) or 1))
    missing = sorted(keys_of[name] - keys)
    if 2 * len(missing) > len(keys_of[name]) or not keys_of[name]:
        return ""
    lacks = []
    for key in missing:
        alike = difflib.get_close_matches(key, sorted(keys - keys_of[name]), 1)
        lacks.append(f"{key} (perhaps {shorten(alike[0], 40)})" if alike else key)
    return f"; most similar: {name}, but the file has no {' and '.join(lacks)}"


def _recognise(content: Content, by_name: Mapping[str, Adapter]) -> str | None:
    """Return the first method whose adapter recognises `content`.

    Plug-ins that raise an exception are skipped.
    """
    for name, adapter in by_name.items():
        try:
            if adapter.recognises(content):
                return name
        except UsageError as error:
            if error.code != "PACKAGE_LEFT_OUT":
                raise
            warn(str(error))
    return None


def _reject_other_method(content: Content, method: str) -> None:
    """Reject a model of another method, unless the adapter of `method` accepts any mesh file."""
    if _adapter(method).recognises(content):
        return
    other = _recognise(content, adapters()) or method
    if other == "mesh" and METHODS[method].reads_meshes:
        return
    if other != method:
        text = f"the file holds a {other} model, but --method is {method}"
        raise CheckpointError("CHECKPOINT_METHOD", text, file=content.place.file)


def _source_files(model: Model, progress: Progress | None) -> list[SourceFile]:
    """Return the path, the hash and the size of each file of a model."""
    sizes = [path.stat().st_size for path in model.files]
    meter = Meter("hashing the source", sum(sizes), progress)
    files = []
    for path, size in zip(model.files, sizes, strict=True):
        files.append(SourceFile(_to_relative(path, model.root), file_sha256(path, meter.advance), size))
    return files


def _to_relative(path: Path, root: Path) -> str:
    """Return `path` relative to `root` with forward slashes, or only the file name if `path` is outside
    `root`.

    Bytes that are not UTF-8 become \\udcXX, because a manifest is text.
    """
    path = path.absolute()
    inside = path.is_relative_to(root.absolute())
    name = path.relative_to(root.absolute()).as_posix() if inside else path.name
    return name.encode(errors="backslashreplace").decode()
