"""Repair assets and meshes.

An asset keeps its manifest. The buffers of the asset are adapted to the repaired mesh.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.api.opening import as_asset
from msb.asset import Asset, Description, build_asset
from msb.asset.frame import frame_of
from msb.asset.look import colors_of, stored_threshold, visible_faces
from msb.asset.manifest import Domain
from msb.asset.origin import world_positions
from msb.asset.tiers import refusal
from msb.base.origin import to_local
from msb.base.seam_keys import SEAM_KEY
from msb.errors import Unsupported, about
from msb.meshes import Mesh
from msb.meshes.assets import with_corner_colors
from msb.meshes.writing import check_indices
from msb.repair.plan import Options, parse_plan
from msb.repair.run import Outcome, list_defects, run_plan
from msb.topology.steps import Change
from msb.topology.steps.change import with_faces


@dataclass(frozen=True, eq=False, repr=False)
class Repaired(Outcome):
    """A repaired asset, and its differences from the original. The original asset is not changed.

    Attributes
    ----------
    asset : Asset
        The repaired asset, in memory. The method is unchanged, unless `weld` merged a triangle soup.
    vertex_map, face_map : (V',), (F',) int64
        The index of the original vertex or face. The value is -1 for added vertices and faces.
    turned : (F',) bool
        Whether the second and third corner of each face were swapped.
    cut_edges : (n, 2) int64
        The original edges that became several edges. An edge is a pair of original vertices.
    plan, steps : tuple of str, tuple of Step
        The requested steps, and the finished steps. The steps are repeated until nothing changes.
    before, after : Audit
        Two audits: one of the original mesh and one of the repaired mesh.
    left : tuple of str
        The remaining defects: non-manifold or open edges, inconsistent winding, and duplicate faces.
    """

    asset: Asset
    plan: tuple[str, ...]

    @property
    def left(self) -> tuple[str, ...]:
        """The remaining defects: non-manifold or open edges, inconsistent winding, and duplicate faces."""
        return tuple(list_defects(self.after))

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
    """Return a repaired copy of an asset that keeps the data of its vertices and faces.

    The default plan, "orient,pair", changes nothing visible. The default plan turns faces to a consistent
    winding, and cuts edges of more than two faces. At a cut edge, the pairs of faces that are closest to flat
    stay connected. The steps and their guarantees are explained in docs/repair.md.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or a path that `msb.open` accepts. The asset is not changed.
    plan : sequence of str, or str, optional
        The steps in order, as a sequence or separated by commas. The names are "orient", "pair", "cut",
        "drop", "weld", "debris", "close", "dedupe" and "outward". The steps are repeated until nothing
        changes. A step may have numbers: "weld:0.01,orient,pair".
    weights : (F,) non-negative numbers, optional
        The weight of each face for the steps `debris` and `drop`, such as the number of pixels that it covers
        in images. Default: the face's area.
    **options
        Other fields of `msb.repair.Options`, such as ``debris_faces=20``.

    Returns
    -------
    Repaired

    Raises
    ------
    UsageError
        `USAGE`, `EXTRA_MISSING`.
    MeshError
        `MESH_NONFINITE`: no face has finite coordinates; `MESH_INDEX_OUT_OF_RANGE`, `WELD_DISTANCE`.
    Unsupported
        `UNSUPPORTED_REPAIR`: a step would leave values of a buffer undefined; `UNSUPPORTED_TIER`: a triangle
        soup without static colours cannot be welded; `PEER_FAILED`: the other library failed.
    AssetError
        `TRIASSET_EMPTY`: no face is left.
    InputError, CheckpointError, MeshFileError
        The path cannot be read.

    Examples
    --------
    >>> import msb
    >>> fixed = msb.repair("data_stubs/splat_like.triasset")
    >>> fixed.before.counts.nonmanifold_edges, fixed.after.counts.nonmanifold_edges, fixed.left
    (10069, 0, ('38,923 boundary edges (add "close" to the plan to fill holes)',))
    """
    return repair_asset(as_asset(asset), parse_plan(plan, **options), weights)


def repair_asset(asset: Asset, options: Options, weights: NDArray[Any] | None = None) -> Repaired:
    """Repair an asset with validated options. See `repair`."""
    plan = options.plan
    with about(asset.path):
        # If the plan welds a triangle soup, convert it to a standard-tier mesh first.
        base, first = _convert_to_mesh(asset) if _welds_soup(asset, plan) else (asset, None)
        manifest = base.manifest
        domains = {name: spec.domain for name, spec in manifest.buffers.items()}
        level = manifest.appearance.get("level")
        level = level if isinstance(level, int) and 0 <= level <= 8 else None
        done = run_plan(
            {**base.buffers, "positions": world_positions(base)},
            domains,
            options,
            level=level,
            weights=weights,
            first=first,
            trained=manifest.method != "mesh",
        )
        if done.unchanged:
            repaired = asset
        else:
            buffers = {**done.buffers, "positions": _find_positions(base, done)}
            repaired = build_asset(buffers, done.domains, Description.of(manifest))
            repaired = replace(
                repaired,
                manifest=replace(repaired.manifest, extra=manifest.extra),
                warnings=asset.warnings,
                opened_from=asset.opened_from,
            )
    # Copy the outcome. Add the path and the method of the asset to its audits.
    path = None if repaired.path is None else str(repaired.path)
    outcome = {f.name: getattr(done, f.name) for f in fields(done)}
    audits = {
        name: replace(audit, path=path, method=manifest.method)
        for name, audit in (("before", done.before), ("after", done.after))
    }
    return Repaired(**outcome | audits | {"buffers": repaired.buffers}, asset=repaired, plan=plan)


def _find_positions(asset: Asset, done: Outcome) -> NDArray[np.float32]:
    """Return the positions of a repaired asset relative to its origin.

    Positions of kept vertices stay identical in all bits.
    """
    positions = to_local(done.buffers["positions"], asset.manifest.origin)
    if not any(asset.manifest.origin):
        return positions
    stays = done.vertex_map >= 0
    positions[stays] = asset.buffers["positions"][done.vertex_map[stays]]
    return positions


def repair_mesh(mesh: Mesh, options: Options) -> tuple[Mesh, Outcome]:
    """Return the repaired mesh, in the precision of `mesh`, and the outcome of the repair."""
    check_indices(mesh)
    # The function `carry` decides by the buffer's name how to change a buffer. Face colours get the name
    # "f_dc", because vertex colours already have the name "color".
    by_corner = mesh.corner_uvs is not None
    arrays: tuple[tuple[str, NDArray[Any] | None, Domain], ...] = (
        ("color", mesh.vertex_colors, "vertex"),
        ("f_dc", mesh.face_colors, "face"),
        ("uv", mesh.corner_uvs if by_corner else mesh.vertex_uvs, "corner" if by_corner else "vertex"),
        ("face_texture", mesh.face_textures, "face"),
        (SEAM_KEY, mesh.vertex_keys, "vertex"),
        (SEAM_KEY, mesh.corner_keys, "corner"),
    )
    domains = {name: domain for name, values, domain in arrays if values is not None}
    buffers = {name: values for name, values, _ in arrays if values is not None}
    done = run_plan({"positions": mesh.vertices, "indices": mesh.faces, **buffers}, domains, options)
    # A repair may convert colours and UVs to corner data.
    moved = {(name, done.domains[name]): done.buffers[name] for name in domains if name != SEAM_KEY}
    repaired = replace(
        mesh,
        vertices=done.buffers["positions"],
        faces=done.buffers["indices"].astype(np.int64),
        vertex_colors=moved.get(("color", "vertex")),
        face_colors=moved.get(("f_dc", "face")),
        vertex_uvs=moved.get(("uv", "vertex")),
        corner_uvs=moved.get(("uv", "corner")),
        face_textures=moved.get(("face_texture", "face")),
        vertex_keys=None,
        corner_keys=None,
        left_out=(),
    )
    colors = moved.get(("color", "corner"))
    return repaired if colors is None else with_corner_colors(repaired, colors), done


def _welds_soup(asset: Asset, plan: tuple[str, ...]) -> bool:
    """Return whether the plan welds a triangle soup of a method that can only render soups."""
    return "weld" in plan and asset.manifest.topology == "triangle_soup" and asset.manifest.method != "mesh"


def _convert_to_mesh(asset: Asset) -> tuple[Asset, Change | None]:
    """Return a triangle soup as an asset of method "mesh" with its standard-tier colours.

    Also return the change that removes faces below the STE opacity threshold. This change is None without a
    threshold.
    """
    if why := refusal(asset.manifest, "standard"):
        raise Unsupported("UNSUPPORTED_TIER", f"weld needs static colours to merge a triangle soup; {why}")
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
        frame=frame_of(manifest),
        origin=manifest.origin,
    )
    visible = visible_faces(asset, stored_threshold(asset))
    if visible is None:
        return build_asset(buffers, domains, description), None
    faces = buffers["indices"].astype(np.int64)
    return build_asset(buffers, domains, description), with_faces(faces, visible, 3 * len(faces))
