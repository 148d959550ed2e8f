"""From a path to an asset: find the model, determine its method, read it and describe it."""

import difflib
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, cast

from msb.adapters.locate import Place, locate
from msb.adapters.model import Content, Model, Options
from msb.asset import Asset, build_asset
from msb.asset.arguments import check_type
from msb.asset.manifest import Source, SourceFile
from msb.asset.progress import Meter, Progress
from msb.asset.settings import parse_overrides
from msb.base.files import file_sha256, is_file
from msb.base.packages import warn
from msb.base.paths import given_path
from msb.errors import CheckpointError, InputError, Unsupported, UsageError, about, shorten
from msb.registry import BUILT_IN, METHODS, role, with_role


class Adapter(Protocol):
    """The functions that an adapter module has; its `KEYS`, if any, are those of each of its state dicts."""

    def recognises(self, content: Content) -> bool:
        """Return whether the content is a model of this method, by features that only this method has."""

    def read(self, place: Place, content: Content, options: Options) -> Model:
        """Return the model, or raise the error about what is wrong with it."""


def adapters() -> dict[str, Adapter]:
    """Return method -> its adapter, in the order in which they are asked: those of installed packages first.

    A package is asked first because it knows our methods, but they do not know it: its files may look like
    ours.
    """
    by_name = {name: adapter for name in METHODS if (adapter := _by_name(name)) is not None}
    by_name |= dict(with_role("adapter"))
    others = [name for name in by_name if name not in BUILT_IN]
    return {name: by_name[name] for name in (*others, *BUILT_IN)}


def _by_name(method: str) -> Adapter | None:
    """Return the adapter of a method that is only shown as a mesh whose file's name says whose it is."""
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
    """Return the trained model at `path` as an asset, without torch and without running anything in it.

    Parameters
    ----------
    path : path-like
        The output folder of a training, or the file in it that holds the model; docs/export.md lists them.
    method : str, optional
        The name of a method, as `msb methods` lists them; found from the content if not given.
    settings : mapping, optional
        Setting -> value; these values replace those of config and checkpoint.
    config : path-like, optional
        YAML config or text log of a 2DTS training, if it does not lie in the output folder.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` with bytes.

    Returns
    -------
    Asset
        An asset in memory; its buffers are views on the checkpoint's file where the layout allows that.
        `Asset.warnings` says what was missing and was replaced by defaults.

    Raises
    ------
    InputError, CheckpointError, MeshFileError, AssetError
        Something is wrong with the files.
    Unsupported
        `UNSUPPORTED_METHOD`: models of this method are not made of triangles.
    UsageError
        An unknown method or setting, or a config for a method whose trainings have none.
    """
    if settings is not None:
        check_type("settings", settings, Mapping, "a mapping from names to values")
    model = read_model(path, method=method, settings=settings or {}, config=config)
    return finish(model, progress=progress)


def finish(model: Model, *, progress: Progress | None = None) -> Asset:
    """Return `model` as an asset: sources and buffers hashed, manifest complete."""
    source = Source(tuple(_hashed(model, progress)))
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
) -> Model:
    """Return the trained model at `path`, or at the place where `locate` found it; errors as for `export`.

    `settings` may also be texts such as "gamma=20", whose values are read as the method wants them. Without
    `check_values` parameters may be NaN, because the audit counts them.
    """
    if method is not None and method not in tuple(METHODS):
        text = f'there is no method "{shorten(str(method), 40)}"; there are {", ".join(METHODS)}'
        raise UsageError("USAGE", text)
    place = path if isinstance(path, Place) else locate(path)
    content = Content(place)
    if method is None:
        method = _detect(content)
    else:
        _refuse_other(content, method)
    values = settings if isinstance(settings, Mapping) else parse_overrides(method, settings)
    given = None if config is None else given_path(config)
    if given is not None and not is_file(given):
        raise InputError("FILE_NOT_FOUND", "there is no such file", file=given)
    model = _adapter(method).read(place, content, Options(values, given, check_values))
    if given is not None and given not in model.files:  # an adapter names all that it has read
        text = f"--config is of no use: {METHODS[method].title}, whose model this is, reads none; 2DTS does"
        raise UsageError("USAGE", text, file=given)
    return replace(model, opened_from=place.given)


def detect(path: str | os.PathLike[str]) -> str:
    """Return the method of the model at `path`."""
    return _detect(Content(locate(path)))


def _adapter(method: str) -> Adapter:
    adapter: Any = role(method, "adapter") or _by_name(method)
    if adapter is None:
        text = f"{METHODS[method].title} brings nothing that reads its models"
        raise Unsupported("UNSUPPORTED_METHOD", text)
    return cast("Adapter", adapter)


def _detect(content: Content) -> str:
    known = adapters()
    method = _recognising(content, known)
    if method is not None:
        return method
    value = content.value
    if isinstance(value, dict):
        what = "its keys are " + (", ".join(shorten(str(key), 30) for key in list(value)[:8]) or "none")
    elif content.ply_names:
        what = "it is a PLY without faces, with " + ", ".join(content.ply_names[:8])
    elif content.place.kind == "torch":
        what = f"it holds a {type(value).__name__}"
    else:
        what = "its content is not what its name promises"
    text = f"{what}; that is no model of {', '.join(known)}{_nearest(value, known)}"
    raise CheckpointError("CHECKPOINT_UNKNOWN", text, file=content.place.file)


def _nearest(value: object, adapters_by_name: Mapping[str, Adapter]) -> str:
    """Return which method most of the keys of `value` are of, and what it calls the others; "" if of none."""
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
        lacks.append(f"{key}, which may be {shorten(alike[0], 40)} here" if alike else key)
    return f"; nearest: {name}, but for {' and '.join(lacks)}"


def _recognising(content: Content, by_name: Mapping[str, Adapter]) -> str | None:
    """Return the first method whose adapter recognises `content`; a package's that fails is left out."""
    for name, adapter in by_name.items():
        try:
            if adapter.recognises(content):
                return name
        except UsageError as error:
            if error.code != "PACKAGE_LEFT_OUT":
                raise
            warn(str(error))
    return None


def _refuse_other(content: Content, method: str) -> None:
    """Refuse a model that another method recognises, unless the one asked for can take it too."""
    if _adapter(method).recognises(content):
        return
    other = _recognising(content, adapters()) or method
    if other == "mesh" and METHODS[method].reads_meshes:
        return
    if other != method:
        text = f"it holds a {other} model; --method says {method}"
        raise CheckpointError("CHECKPOINT_METHOD", text, file=content.place.file)


def _hashed(model: Model, progress: Progress | None) -> list[SourceFile]:
    sizes = [path.stat().st_size for path in model.files]
    meter = Meter("hashing the source", sum(sizes), progress)
    files = []
    for path, size in zip(model.files, sizes, strict=True):
        files.append(SourceFile(_relative(path, model.root), file_sha256(path, meter.advance), size))
    return files


def _relative(path: Path, root: Path) -> str:
    """Return `path` below `root` with forward slashes, or its name alone: never where it lay on this disk.

    Bytes that are not UTF-8 become \\udcXX: a manifest is text.
    """
    path = path.absolute()
    inside = path.is_relative_to(root.absolute())
    name = path.relative_to(root.absolute()).as_posix() if inside else path.name
    return name.encode(errors="backslashreplace").decode()
