"""From a path to an asset: find the model, ask which method it is of, read it, describe it."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from msb.adapters import (
    diffsoup,
    diffsoup_web,
    mesh,
    mesh_splatting,
    three_dgs,
    triangle_splatting,
    two_dgs,
    two_dts,
)
from msb.adapters.content import Content, Options
from msb.adapters.locate import locate
from msb.asset import Asset, build_asset
from msb.asset.manifest import Source, SourceFile
from msb.asset.progress import Meter
from msb.errors import CheckpointError, InputError, MsbError, UsageError, shorten
from msb.methods import METHODS

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

    from msb.adapters.locate import Place
    from msb.adapters.model import Model
    from msb.asset.progress import Progress

_CHUNK = 1 << 24


class Adapter(Protocol):
    """What an adapter module offers."""

    def recognises(self, content: Content) -> bool:
        """Return whether the content is of this method, by what only this method has."""

    def read(self, place: Place, content: Content, options: Options) -> Model:
        """Return the model, or raise what is wrong with it."""


ADAPTERS: dict[str, Adapter] = {
    "two_dts": two_dts,
    "mesh_splatting": mesh_splatting,
    "triangle_splatting": triangle_splatting,
    "diffsoup": diffsoup,
    "two_dgs": two_dgs,
    "three_dgs": three_dgs,
    "mesh": mesh,
}
"""Method -> its adapter, in the order in which they are asked."""


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
        A name of `msb methods`; found from the content if not given.
    settings : mapping, optional
        Setting -> value; these rule over what config and checkpoint say.
    config : path-like, optional
        YAML config or text log of a 2DTS training, if it does not lie in the output folder.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` with bytes.

    Returns
    -------
    Asset
        In memory; its buffers are views on the checkpoint's file where the layout allows that. What was
        missing and replaced by defaults is in `Asset.warnings`.

    Raises
    ------
    InputError, CheckpointError, MeshFileError, AssetError
        What is wrong with the files.
    Unsupported
        `UNSUPPORTED_METHOD`: models of this method are not made of triangles.
    UsageError
        An unknown method or setting.
    """
    return finish(read_model(path, method=method, settings=settings, config=config), progress=progress)


def finish(model: Model, *, progress: Progress | None = None) -> Asset:
    """Return `model` as an asset: sources and buffers hashed, manifest complete.

    Raises
    ------
    InputError, AssetError
    """
    source = Source(tuple(_hashed(model, progress)))
    description = replace(model.description, source=source)
    try:
        asset = build_asset(model.buffers, model.domains, description, progress=progress)
    except MsbError as error:
        if error.file is not None:
            raise
        where = {"pointer": error.pointer, "value": error.value, "limit": error.limit}
        raise type(error)(error.code, error.message, file=model.files[0], **where) from error
    return replace(asset, warnings=model.warnings)


def read_model(
    path: str | os.PathLike[str],
    *,
    method: str | None = None,
    settings: Mapping[str, Any] | None = None,
    config: str | os.PathLike[str] | None = None,
    check_values: bool = True,
) -> Model:
    """Return the trained model at `path`; parameters and errors as for `export`.

    Without `check_values` parameters that are NaN are let through, for the audit, which counts them.
    """
    if method is not None and method not in METHODS:
        text = f'there is no method "{shorten(method, 40)}"; there are {", ".join(METHODS)}'
        raise UsageError("USAGE", text, value=method)
    place = locate(path)
    content = Content(place)
    options = Options(settings or {}, None if config is None else Path(config), check_values)
    if method is not None:
        _refuse_other(content, method)
    chosen = method or _detect(content)
    if place.kind == "web":
        return diffsoup_web.read(place, content, options)
    return ADAPTERS[chosen].read(place, content, options)


def detect(path: str | os.PathLike[str]) -> str:
    """Return the method of the model at `path`.

    Raises
    ------
    InputError, CheckpointError, MeshFileError
    """
    return _detect(Content(locate(path)))


def _detect(content: Content) -> str:
    if content.place.kind == "web":
        return "diffsoup"
    for name, adapter in ADAPTERS.items():
        if adapter.recognises(content):
            return name
    value = content.value
    if isinstance(value, dict):
        what = "its keys are " + (", ".join(shorten(str(key), 30) for key in list(value)[:8]) or "none")
    elif content.ply_names:
        what = "it is a PLY without faces, with " + ", ".join(content.ply_names[:8])
    else:
        what = f"it holds a {type(value).__name__}"
    text = f"{what}; that is no model of {', '.join(ADAPTERS)}"
    raise CheckpointError("CHECKPOINT_UNKNOWN", text, file=content.place.file)


def _refuse_other(content: Content, method: str) -> None:
    """Refuse a model that another method recognises, unless the one asked for can take it too."""
    if content.place.kind == "web":
        found = "diffsoup"
    elif ADAPTERS[method].recognises(content):
        return
    else:
        found = next((name for name, adapter in ADAPTERS.items() if adapter.recognises(content)), method)
    # A mesh file does not say who wrote it: MeshSplatting and 2DGS take one as their own export.
    if found == "mesh" and method in ("mesh_splatting", "two_dgs"):
        return
    if found == "two_dgs" and method == "mesh" and not content.ply_names:
        return
    if found != method:
        text = f"it holds a {found} model; --method says {method}"
        raise CheckpointError("CHECKPOINT_METHOD", text, file=content.place.file, value=found, limit=method)


def _hashed(model: Model, progress: Progress | None) -> list[SourceFile]:
    sizes = [path.stat().st_size for path in model.files]
    meter = Meter("hashing the source", sum(sizes), progress)
    found = []
    for path, size in zip(model.files, sizes, strict=True):
        digest = hashlib.sha256()
        try:
            with path.open("rb") as file:
                while chunk := file.read(_CHUNK):
                    digest.update(chunk)
                    meter.advance(len(chunk))
        except OSError as error:
            raise InputError("FILE_UNREADABLE", f"it cannot be read: {error.strerror}", file=path) from error
        found.append(SourceFile(_relative(path, model.root), digest.hexdigest(), size))
    return found


def _relative(path: Path, root: Path) -> str:
    """Return `path` below `root` with forward slashes, or its name alone: never where it lay on this disk.

    Bytes that are not UTF-8 become \\udcXX: a manifest is text.
    """
    path = path.absolute()
    inside = path.is_relative_to(root.absolute())
    name = path.relative_to(root.absolute()).as_posix() if inside else path.name
    return name.encode(errors="backslashreplace").decode()
