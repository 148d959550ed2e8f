"""The function `msb.validate` reports all errors of a file."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from msb.asset import Validation, is_asset
from msb.asset import validate as validate_asset
from msb.base.paths import given_path
from msb.errors import Finding, InputError, MsbError, Unsupported, error_finding, finding

_SEVERITIES = ("error", "warning", "info")


def validate(path: str | os.PathLike[str]) -> Validation:
    """Check an asset completely: container, manifest, sizes, hashes and values.

    Parameters
    ----------
    path : str or Path
        An asset, a mesh file or a checkpoint. A mesh file or checkpoint is converted to an asset in memory,
        and this asset is checked.

    Returns
    -------
    Validation
        The result has the attributes `valid` and `findings`. Errors come first. `print` shows the result as a
        readable list. `msb validate --explain CODE` gives the remedy for a code.

    Raises
    ------
    InputError
        The file does not exist, cannot be read or is not recognised.
    Unsupported
        The path is a checkpoint of a method that cannot be converted.

    Examples
    --------
    >>> import msb
    >>> report = msb.validate("data_stubs/splat_like.triasset")
    >>> report.valid
    True
    """
    place = given_path(path)
    if not is_asset(place):
        return _check_other(place)
    result = validate_asset(place)
    # Errors come first, because a file can have thousands of warnings.
    findings = sorted(result.findings, key=lambda item: _SEVERITIES.index(item.severity))
    if result.asset is not None and result.valid:
        findings += _degenerate(result.asset.buffers["positions"], result.asset.buffers["indices"])
    return replace(result, findings=tuple(findings))


def _check_other(path: Path) -> Validation:
    """Check a mesh file or checkpoint by converting it to an asset."""
    from msb.adapters.exporter import finish, read_model

    try:
        asset = finish(read_model(path, reject="everything"))
    except (InputError, Unsupported):
        raise
    except MsbError as error:
        return Validation(path, (error_finding(error),), None)
    degenerate = _degenerate(asset.buffers["positions"], asset.buffers["indices"])
    return Validation(path, (*asset.warnings, *degenerate), asset)


def _degenerate(positions: Any, indices: Any) -> Iterator[Finding]:
    """Yield infos about invisible and duplicate faces, and about unused vertices."""
    import numpy as np

    from msb.topology.arrays import mesh_arrays
    from msb.topology.faces import face_areas, find_duplicate_faces, has_no_area, names_vertex_twice

    # For each problem, a mask of the affected faces (F,) or vertices (V,).
    points, faces = mesh_arrays(positions, indices)
    repeated = names_vertex_twice(faces)
    area, finite = face_areas(points, faces)
    unused = np.ones(len(points), bool)
    unused[faces[~repeated]] = False
    for code, where, what in (
        ("TRIASSET_FACE_REPEATED_INDEX", repeated, "faces list a vertex twice"),
        ("TRIASSET_FACE_DUPLICATE", find_duplicate_faces(faces), "faces repeat an earlier face"),
        ("TRIASSET_FACE_ZERO_AREA", has_no_area(area, finite, repeated), "faces have no area"),
        ("TRIASSET_VERTEX_UNREFERENCED", unused, "vertices are not used by a valid face"),
    ):
        if count := int(np.count_nonzero(where)):
            text = f"{count:,} {what}, the first is {int(np.argmax(where))}"
            yield finding(code, text, severity="info", pointer="indices", value=count)
