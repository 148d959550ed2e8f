"""The function `msb.validate`: everything that is wrong with what lies at a path."""

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
        An asset; or a mesh file or a checkpoint, which is judged by the asset that would be made of it.

    Returns
    -------
    Validation
        `valid`, and `findings`, errors first, each with its code; `msb validate --explain CODE` says what to
        do about it. Printed, it is a few lines.

    Raises
    ------
    InputError
        There is nothing at `path`, or it cannot be read or is not recognised.
    Unsupported
        It is a checkpoint of a method that has no asset.

    Examples
    --------
    >>> import msb
    >>> found = msb.validate("data_stubs/splat_like.triasset")
    >>> found.valid
    True
    """
    place = given_path(path)
    if not is_asset(place):
        return _check_other(place)
    result = validate_asset(place)
    # Errors first: they must not drown in warnings.
    findings = sorted(result.findings, key=lambda item: _SEVERITIES.index(item.severity))
    if result.asset is not None and result.valid:
        findings += _degenerate(result.asset.buffers["positions"], result.asset.buffers["indices"])
    return replace(result, findings=tuple(findings))


def _check_other(path: Path) -> Validation:
    """Check what is no asset by the asset made of it."""
    from msb.adapters.exporter import export

    try:
        asset = export(path)
    except (InputError, Unsupported):
        raise
    except MsbError as error:
        return Validation(path, (error_finding(error),), None)
    degenerate = _degenerate(asset.buffers["positions"], asset.buffers["indices"])
    return Validation(path, (*asset.warnings, *degenerate), asset)


def _degenerate(positions: Any, indices: Any) -> Iterator[Finding]:
    """Yield infos about faces that draw nothing or twice, and vertices that nothing uses."""
    import numpy as np

    from msb.topology.arrays import mesh_arrays
    from msb.topology.faces import extra_duplicates, face_areas, has_no_area, names_vertex_twice

    points, faces = mesh_arrays(positions, indices)
    repeated = names_vertex_twice(faces)
    area, finite = face_areas(points, faces)
    unused = np.ones(len(points), bool)
    unused[faces[~repeated]] = False
    for code, where, what in (
        ("TRIASSET_FACE_REPEATED_INDEX", repeated, "faces name a vertex twice"),
        ("TRIASSET_FACE_DUPLICATE", extra_duplicates(faces), "faces repeat an earlier one"),
        ("TRIASSET_FACE_ZERO_AREA", has_no_area(area, finite, repeated), "faces have no area"),
        ("TRIASSET_VERTEX_UNREFERENCED", unused, "vertices are in no proper face"),
    ):
        if count := int(np.count_nonzero(where)):
            text = f"{count:,} {what}, the first is {int(np.argmax(where))}"
            yield finding(code, text, severity="info", pointer="indices", value=count)
