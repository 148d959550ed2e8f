"""Functions of several commands: open assets, process several inputs, write a mesh with additional files."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from msb.api.inputs import inputs_at, matches
from msb.asset import Asset
from msb.base.paths import real_place
from msb.cli.output import Output, report_error
from msb.errors import Finding, MsbError, UsageError
from msb.meshes import Mesh
from msb.meshes.formats import Style


def open_asset(path: Path, output: Output) -> Asset:
    """Open an asset and print its warnings."""
    from msb.api.opening import open

    with output.progress(f"reading {path.name}"):
        asset = open(path)
    note_opened(path, asset, output)
    return asset


def note_opened(path: Path, asset: Asset, output: Output) -> None:
    """Print warnings of the asset, and the name of the checkpoint that was opened in the folder at `path`."""
    from msb.api.opening import describe_opened

    for text in describe_opened(path, asset):
        output.note(text)


def open_baked(path: Path, asset: Asset, output: Output) -> Asset:
    """Open a mesh that was baked from `asset`, and rotate the mesh into the coordinates of `asset`."""
    from msb.meshes.assets import align_baked

    return align_baked(open_asset(path, output), asset)


def for_each(
    paths: Iterable[Path],
    schema: str,
    output: Output,
    work: Callable[[Path, bool], tuple[dict[str, Any], int]],
    single: Iterable[str] = (),
) -> tuple[int, list[dict[str, Any]]]:
    """Process all inputs one after the other. Write a JSON document for each input.

    If an input fails, its error is printed. With several inputs, a JSON document with the error is also
    written.

    Parameters
    ----------
    paths : iterable of Path
        Files, folders and patterns of the command line. Repeated inputs are processed only once.
    schema : str
        Schema of error documents.
    output : Output
    work : callable
        ``(path, is_only_input) -> (document, exit status)``.
    single : iterable of str
        The options on the command line that allow only one input.

    Returns
    -------
    status : int
        The highest exit status of the inputs.
    documents : list of dict
    """
    status = 0
    documents: list[dict[str, Any]] = []

    # The errors of inputs are collected. The command continues after an error unless --fail-fast was given.
    def fail(path: Path, error: MsbError) -> int:
        output.reword(error)
        details = {"code": error.code, "message": error.message}
        documents.append({"schema": schema, "path": str(path), "error": details})
        return max(status, report_error(error))

    def expand(path: Path, step: Callable[[Path], list[Path]]) -> list[Path]:
        nonlocal status
        if status and output.fail_fast:
            return []
        try:
            return step(path)
        except MsbError as error:
            status = fail(path, error)
            return []

    # Expand patterns before folders, because a pattern can match both a folder and files in this folder.
    named = [match for path in _without_repeats(paths) for match in expand(path, matches)]
    inputs = _without_repeats(each for path in _without_repeats(named) for each in expand(path, inputs_at))
    output.add_inputs(inputs)
    if len(inputs) > 1 and (labels := list(single)):
        raise UsageError("USAGE", f"{labels[0]} needs exactly one mesh, but there are {len(inputs)}")
    # Process the inputs in turn, and keep the highest exit status.
    for path in inputs:
        if status and output.fail_fast:
            break
        try:
            document, its_status = work(path, len(inputs) == 1)
        except MsbError as error:
            status = fail(path, error)
            continue
        documents.append(document)
        status = max(status, its_status)
    # If the only input failed, print a line on standard error, and write no document.
    if len(documents) > 1 or (documents and "error" not in documents[0]):
        output.write_documents(documents)
    return status, documents


def _without_repeats(paths: Iterable[Path]) -> list[Path]:
    """Return `paths` without later paths to the same file. All hard links to a file are kept."""
    first: dict[str, Path] = {}
    for path in paths:
        first.setdefault(real_place(path), path)
    return list(first.values())


def note_warnings(warnings: Iterable[Finding], path: Path, output: Output) -> None:
    """Print warnings about the file at `path`."""
    for warning in warnings:
        output.note(warning.to_line(path))


def write_mesh_files(mesh: Mesh, target: Path, output: Output, style: Style | None = None) -> None:
    """Write a mesh and its other files, such as textures. Without --force, none of these files may exist."""
    from msb.meshes.files import write_whole

    write_whole(mesh, target, style, overwrite=output.force, check_companion=output.check_free)


def check_asset_place(target: Path, form: str | None, output: Output) -> None:
    """Check the output path of a `.triasset`. An existing folder is replaced only if it contains an asset."""
    from msb.asset.writer import check_asset_folder

    output.check_free(target, folder=form == "folder", label="OUT")
    if form == "folder":
        check_asset_folder(target)
