"""Files of commands: inputs are opened one after the other, and meshes are written with what they need."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.api.inputs import inputs_at, matches
from msb.cli.output import report_error
from msb.errors import MsbError, UsageError

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.cli.output import Output
    from msb.errors import Finding
    from msb.meshes import Mesh
    from msb.meshes.formats import Style


def open_asset(path: Path, output: Output) -> Asset:
    """Return the asset that `msb.open` gives, and print its warnings."""
    from msb.api.opening import open

    with output.progress(f"reading {path.name}"):
        asset = open(path)
    note_taken(path, asset.opened_from, output)
    note_warnings(asset.warnings, path, output)
    return asset


def note_taken(path: Path, taken: Path | None, output: Output) -> None:
    """Say which checkpoint was taken for the folder at `path`, if it is not that one itself."""
    if taken is not None and taken != path:
        output.note(f"{path}: the checkpoint in it is taken, {taken}")


def open_baked(path: Path, asset: Asset, output: Output) -> Asset:
    """Return what was baked of an asset, turned back if its file is upright and the asset is not."""
    from msb.asset.look import written_up
    from msb.meshes.assets import asset_from_mesh, mesh_from_asset
    from msb.meshes.transform import turned

    mesh = mesh_from_asset(open_asset(path, output))
    up = written_up(asset)
    vertices = turned(mesh.vertices, mesh.up or "unknown", up or "unknown")
    return asset_from_mesh(replace(mesh, vertices=vertices, up=up))


def for_each(
    paths: Iterable[Path],
    schema: str,
    output: Output,
    work: Callable[[Path, bool], tuple[dict[str, Any], int]],
    single: Iterable[str] = (),
) -> tuple[int, list[dict[str, Any]]]:
    """Call `work` with each input; write the documents that it returns, return the highest status and them.

    An input that is named twice, in two spellings or as a file and by its folder, is one. `work` is told
    whether the input is alone. An input that fails is a line on standard error, and a document with its error
    beside those of others. `single` are the options that take one input.
    """
    status = 0
    documents: list[dict[str, Any]] = []

    def fail(path: Path, error: MsbError) -> int:
        output.reword(error)
        wrong = {"code": error.code, "message": error.message}
        documents.append({"schema": schema, "path": str(path), "error": wrong})
        return max(status, report_error(error))

    def found(step: Callable[[Path], list[Path]], path: Path) -> list[Path]:
        nonlocal status
        if status and output.fail_fast:
            return []
        try:
            return step(path)
        except MsbError as error:
            status = fail(path, error)
            return []

    named = [each for path in _each_once(paths) for each in found(matches, path)]
    # A pattern may match a folder and the files in it, too.
    inputs = _each_once(each for path in _each_once(named) for each in found(inputs_at, path))
    output.add_inputs(inputs)
    for option in single if len(inputs) > 1 else ():
        raise UsageError("USAGE", f"{option} takes one mesh; there are {len(inputs)}")
    for path in inputs:
        if status and output.fail_fast:
            break
        try:
            document, own = work(path, len(inputs) == 1)
        except MsbError as error:
            status = fail(path, error)
            continue
        documents.append(document)
        status = max(status, own)
    if len(documents) > 1 or (documents and "error" not in documents[0]):
        output.write_documents(documents)
    return status, documents


def _each_once(paths: Iterable[Path]) -> list[Path]:
    """Return the first path of all that lead to one place; two names of one file (hard links) are two."""
    first: dict[str, Path] = {}
    for path in paths:
        first.setdefault(os.path.realpath(path) if "\0" not in str(path) else str(path), path)
    return list(first.values())


def note_warnings(warnings: Iterable[Finding], path: Path, output: Output) -> None:
    """Print what the reader of `path` warned of."""
    for warning in warnings:
        output.note(warning.to_line(path))


def write_mesh_files(mesh: Mesh, target: Path, output: Output, style: Style | None = None) -> None:
    """Write a mesh with the files that it needs beside it; none of them may exist without --force."""
    from msb.meshes.files import beside, write_whole
    from msb.meshes.formats import Style

    for other in beside(mesh, target, style or Style()):
        output.check_free(other)
    write_whole(mesh, target, style, overwrite=output.force)


def check_asset_place(target: Path, form: str | None, output: Output) -> None:
    """Reject a place for a `.triasset` of this form; of an existing folder only an asset is replaced."""
    from msb.asset.writer import check_asset_folder

    output.check_free(target, folder=form == "folder")
    if form == "folder":
        check_asset_folder(target)
