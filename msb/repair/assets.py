"""Repair an asset: the manifest stays, buffers are carried, and every tier draws the repaired thing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.api.opening import as_asset
from msb.asset import Asset, Description, build_asset
from msb.asset.look import colors_of, stored_threshold, visible_faces
from msb.asset.manifest import Domain
from msb.asset.tiers import refusal
from msb.errors import Unsupported, about
from msb.meshes import Mesh
from msb.meshes.assets import with_corner_colors
from msb.meshes.writing import check_indices
from msb.repair.plan import Options, parse_plan
from msb.repair.run import Outcome, run_plan, what_is_left
from msb.topology.steps import Change
from msb.topology.steps.change import with_faces


@dataclass(frozen=True, eq=False, repr=False)
class Repaired(Outcome):
    """A repaired asset. Its original is as it was.

    Attributes
    ----------
    asset : Asset
        The repaired asset, of the same method unless `weld` joined a triangle soup; in memory.
    vertex_map, face_map : (V',), (F',) int64
        The row of the original that each new vertex and face is; -1 for what is new.
    turned : (F',) bool
        Whether the second and the third corner of a face changed places.
    cut_edges : (n, 2) int64
        The vertices of the original whose edge became several.
    plan, steps : tuple of str, tuple of Step
        What was to be done, and what was, in order; a plan is repeated until nothing changes.
    before, after : Audit
    left : tuple of str
        What still is not manifold, consistently wound, free of doubles, or closed.
    """

    asset: Asset
    plan: tuple[str, ...]

    @property
    def left(self) -> tuple[str, ...]:
        """What still is not manifold, consistently wound, free of doubles, or closed."""
        return tuple(what_is_left(self.after))

    def __repr__(self) -> str:
        before, after = (f"{a.verdict} ({a.counts.faces:,} faces)" for a in (self.before, self.after))
        return f"<Repaired by {','.join(self.plan)}: {before} -> {after}>"


def repair(
    asset: Asset | str | os.PathLike[str],
    plan: Sequence[str] | str | None = None,
    *,
    weights: NDArray[Any] | None = None,
    **options: Any,
) -> Repaired:
    """Return a repaired copy of an asset, with all that its vertices and faces hold carried along.

    The default plan, "orient,pair", changes nothing that is drawn: faces are turned to a consistent winding,
    and where more than two meet at an edge those that continue each other stay together. docs/repair.md says
    what each step does and guarantees.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or the path of anything that `msb.open` takes. It is not changed.
    plan : sequence of str, or str, optional
        Steps in their order, or their names with commas between: "orient", "pair", "cut", "drop", "weld",
        "debris", "close". They are repeated until none changes anything. Numbers may stand after a step:
        "weld:0.01,orient,pair".
    weights : (F,) non-negative numbers, optional
        The weight of each face to `debris` and `drop`, such as pixels seen; the area if not given.
    **options
        The other fields of `msb.repair.Options` by their names, such as ``debris_faces=20``.

    Returns
    -------
    Repaired

    Raises
    ------
    UsageError
        `USAGE`, `EXTRA_MISSING`.
    MeshError
        `MESH_NONFINITE`, naming the vertex; `MESH_INDEX_OUT_OF_RANGE`, `WELD_DISTANCE`.
    Unsupported
        `UNSUPPORTED_REPAIR`: a buffer cannot be carried through a step; `UNSUPPORTED_TIER`: a soup
        without static colours cannot be welded; `PEER_FAILED`.
    AssetError
        `TRIASSET_EMPTY`: nothing was left.
    InputError, CheckpointError, MeshFileError
        The path cannot be read.

    Examples
    --------
    >>> import msb
    >>> fixed = msb.repair("data_stubs/splat_like.triasset")
    >>> fixed.before.counts.nonmanifold_edges, fixed.after.counts.nonmanifold_edges, fixed.left
    (10069, 0, ('38,923 boundary edges: open stays open unless close fills holes',))
    """
    return repair_asset(as_asset(asset), parse_plan(plan, **options), weights)


def repair_asset(asset: Asset, options: Options, weights: NDArray[Any] | None = None) -> Repaired:
    """Return what `repair` does, for options that were checked."""
    plan = options.plan
    with about(asset.path):
        base, first = _as_mesh(asset) if _is_joined(asset, plan) else (asset, None)
        manifest = base.manifest
        domains = {name: spec.domain for name, spec in manifest.buffers.items()}
        level = manifest.appearance.get("level")
        level = level if isinstance(level, int) and 0 <= level <= 8 else None
        done = run_plan(base.buffers, domains, options, level=level, weights=weights, first=first)
        if first is None and not any(step.changed for step in done.steps):
            made = asset
        else:
            described = {f.name: getattr(manifest, f.name) for f in fields(Description)}
            made = build_asset(done.buffers, done.domains, Description(**described))
            kept_manifest = replace(made.manifest, extra=manifest.extra)
            made = replace(
                made, manifest=kept_manifest, warnings=asset.warnings, opened_from=asset.opened_from
            )
    path = None if made.path is None else str(made.path)
    kept = {f.name: getattr(done, f.name) for f in fields(done)}
    audits = {
        name: replace(audit, path=path, method=manifest.method)
        for name, audit in (("before", done.before), ("after", done.after))
    }
    return Repaired(**kept | audits | {"buffers": made.buffers}, asset=made, plan=plan)


def repair_mesh(mesh: Mesh, options: Options) -> tuple[Mesh, Outcome]:
    """Return a repaired mesh in the precision of its file, and what was done."""
    check_indices(mesh)
    # Names that `carry` knows: "f_dc" is any colour.
    by_corner = mesh.corner_uvs is not None
    held: tuple[tuple[str, NDArray[Any] | None, Domain], ...] = (
        ("color", mesh.vertex_colors, "vertex"),
        ("f_dc", mesh.face_colors, "face"),
        ("uv", mesh.corner_uvs if by_corner else mesh.vertex_uvs, "corner" if by_corner else "vertex"),
        ("face_texture", mesh.face_textures, "face"),
    )
    domains = {name: domain for name, values, domain in held if values is not None}
    buffers = {name: values for name, values, _ in held if values is not None}
    done = run_plan({"positions": mesh.vertices, "indices": mesh.faces, **buffers}, domains, options)
    made = {(name, done.domains[name]): done.buffers[name] for name in domains}
    repaired = replace(
        mesh,
        vertices=done.buffers["positions"],
        faces=done.buffers["indices"].astype(np.int64),
        vertex_colors=made.get(("color", "vertex")),
        face_colors=made.get(("f_dc", "face")),
        vertex_uvs=made.get(("uv", "vertex")),
        corner_uvs=made.get(("uv", "corner")),
        face_textures=made.get(("face_texture", "face")),
        left_out=(),
    )
    colors = made.get(("color", "corner"))
    return repaired if colors is None else with_corner_colors(repaired, colors), done


def _is_joined(asset: Asset, plan: tuple[str, ...]) -> bool:
    """Return whether the plan welds a soup of a method that draws soups alone."""
    return "weld" in plan and asset.manifest.topology == "triangle_soup" and asset.manifest.method != "mesh"


def _as_mesh(asset: Asset) -> tuple[Asset, Change | None]:
    """Return a soup as a mesh of its standard look, and the change that leaves out the faces it hides."""
    if why := refusal(asset.manifest, "standard"):
        raise Unsupported("UNSUPPORTED_TIER", f"weld turns a soup into a mesh of static colours; {why}")
    buffers = {name: asset.buffers[name] for name in ("positions", "indices")}
    domains: dict[str, Domain] = {}
    if (colors := colors_of(asset)) is not None:
        buffers["color"], domains["color"] = colors.values, colors.domain
    manifest = asset.manifest
    description = Description(
        appearance={"kind": "static_color" if domains else "none"},
        color_space=manifest.color_space,
        coordinate_frame=manifest.coordinate_frame,
        source=manifest.source,
    )
    shown = visible_faces(asset, stored_threshold(asset))
    if shown is None:
        return build_asset(buffers, domains, description), None
    faces = buffers["indices"].astype(np.int64)
    return build_asset(buffers, domains, description), with_faces(faces, shown, 3 * len(faces))
