"""Run the steps of a plan until nothing changes, and list the remaining defects."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import static_colors
from msb.base.seam_keys import SEAM_KEY
from msb.errors import AssetError, MeshError, UsageError
from msb.repair.buffers import carry
from msb.repair.plan import BY_PEER
from msb.topology import audit_arrays
from msb.topology.arrays import mesh_arrays
from msb.topology.faces import face_areas
from msb.topology.halfedge import NONE
from msb.topology.seams import find_seams, seam_attributes
from msb.topology.steps import close, cut, debris, dedupe, drop, orient, outward, pair, weld
from msb.topology.steps.change import followed_by, unchanged, with_faces, with_vertices
from msb.topology.steps.cut import cut_edges
from msb.topology.verdict import is_worth_merging, judge

if TYPE_CHECKING:
    from msb.asset.manifest import Domain
    from msb.repair.plan import Options
    from msb.topology import Audit
    from msb.topology.seams import Seams
    from msb.topology.steps import Change

    Buffers = Mapping[str, NDArray[Any]]

# The keys are steps. Each value contains the later steps after which the step need not be repeated. Turning
# faces moves no vertex, and `debris` removes whole components. However, `orient` cuts one-sided surfaces, so
# a component may fall apart. Therefore `debris` must be repeated after `orient`.
_UNTOUCHED_BY = {
    "orient": ("orient", "debris"),
    **dict.fromkeys(("pair", "cut"), ("pair", "cut", "orient", "debris")),
    "drop": ("drop", "orient", "debris"),
    "debris": ("debris",),
    "dedupe": ("orient", "pair", "cut", "drop", "dedupe", "debris", "outward"),
    "outward": ("outward",),
}
# After the steps pair, cut or drop, no edge has more than two faces. The steps pair, cut and drop decide
# which faces stay connected, so `orient` must not cut edges in such a plan.
_RESOLVING = frozenset({"pair", "cut", "drop"})
# Maximum number of repetitions of a plan. Most plans need two or three repetitions.
_MAX_ROUNDS = 16


@dataclass(frozen=True)
class Step:
    """A finished step: the numbers of changed faces and vertices, and notes.

    Texts in `notes` have no full stop at the end.
    """

    step: str
    faces_removed: int
    faces_added: int
    faces_turned: int
    vertices_removed: int
    vertices_added: int
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> tuple[int, ...]:
        """The counts of faces removed, added and turned, and of vertices removed and added."""
        faces = (self.faces_removed, self.faces_added, self.faces_turned)
        return (*faces, self.vertices_removed, self.vertices_added)

    @property
    def changed(self) -> bool:
        """Whether the step changed anything."""
        return any(self.counts)

    def to_dict(self) -> dict[str, Any]:
        """Return the step as JSON data."""
        return {**vars(self), "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class Outcome:
    """A repaired mesh: its buffers, the finished steps, and the original index of each row.

    The fields `vertex_map` (V',) and `face_map` (F',) contain the original index of each vertex and face. The
    index of added vertices and faces is -1. The field `turned` (F',) marks faces whose second and third
    corner were swapped. The field `domains` gives the domain of each buffer. If the repair changed the mesh,
    UVs are stored per corner.
    """

    buffers: Buffers
    domains: Mapping[str, Domain]
    vertex_map: NDArray[np.int64]
    face_map: NDArray[np.int64]
    turned: NDArray[np.bool_]
    steps: tuple[Step, ...]
    before: Audit
    after: Audit

    @property
    def unchanged(self) -> bool:
        """Whether the mesh is unchanged."""
        return self.after is self.before

    @cached_property
    def cut_edges(self) -> NDArray[Any]:
        """The original edges (n, 2) that became several edges, as pairs of original vertices."""
        return cut_edges(mesh_arrays(self.buffers["positions"], self.buffers["indices"])[1], self.vertex_map)


@dataclass
class _State:
    """The state of the mesh after the steps that have run so far.

    A step that adds rows updates the field `buffers` immediately. All other changes are accumulated in
    `pending`, until `flush` applies them.
    """

    buffers: Buffers
    domains: Mapping[str, Domain]
    level: int | None
    pending: Change
    vertex_map: NDArray[Any]
    face_map: NDArray[Any]
    turned: NDArray[np.bool_]
    points: NDArray[Any]
    weights: NDArray[Any] | None
    steps: list[Step] = field(default_factory=list)

    def run_step(self, name: str, compute: Callable[[], Change]) -> None:
        """Compute, apply and record the change of a step."""
        start = time.perf_counter()
        change = compute()
        faces, vertices = len(self.face_map), len(self.points)
        added_faces = len(change.added_from)
        unique = len(np.unique(change.vertex_map[change.vertex_map != NONE]))
        done = Step(
            step=name,
            faces_removed=faces - (len(change.face_map) - added_faces),
            faces_added=added_faces,
            faces_turned=int(np.count_nonzero(change.turned)),
            vertices_removed=vertices - unique,
            vertices_added=len(change.vertex_map) - unique,
            seconds=0.0,
            notes=change.notes,
        )
        if done.changed:
            self.apply(change)
        self.steps.append(replace(done, seconds=time.perf_counter() - start))

    def apply(self, change: Change) -> None:
        """Apply a change to the maps and points.

        Changes that add rows are also applied to the buffers. Changes without added rows are collected.
        """
        old_vertex, old_face = change.vertex_map, change.face_map
        self.vertex_map = np.where(old_vertex == NONE, NONE, self.vertex_map[old_vertex])
        self.turned = np.where(old_face == NONE, False, self.turned[old_face]) ^ change.turned
        if self.weights is not None:
            self.weights = np.where(old_face == NONE, 0, self.weights[old_face])
        self.face_map = np.where(old_face == NONE, NONE, self.face_map[old_face])
        if change.rims.count or len(change.added_from):
            self.flush()
            self.buffers = carry(self.buffers, self.domains, change, self.level)
            self.pending = unchanged(change.faces, len(change.vertex_map))
            self.points = self.buffers["positions"]
        else:
            self.points = self.points[old_vertex]
            self.pending = followed_by(self.pending, change)

    def flush(self) -> None:
        """Apply the pending changes to the buffers."""
        self.buffers = carry(self.buffers, self.domains, self.pending, self.level)
        self.pending = unchanged(self.pending.faces, len(self.pending.vertex_map))

    def colors(self) -> dict[str, NDArray[Any]]:
        """Return vertex or face colours as keyword arguments of `pair`. `pair` cannot use corner colours."""
        static = static_colors(self.buffers, self.domains)
        if static is None or static.domain == "corner":
            return {}
        rows = self.pending.vertex_map if static.domain == "vertex" else self.pending.face_map
        values = static.values[rows, :3]
        return {f"{static.domain}_colors": values / 255 if values.dtype == np.uint8 else values}


def run_plan(
    buffers: Buffers,
    domains: Mapping[str, Domain],
    options: Options,
    *,
    level: int | None = None,
    weights: NDArray[Any] | None = None,
    first: Change | None = None,
    trained: bool = False,
) -> Outcome:
    """Run the steps of the plan in order, and repeat all steps except weld until nothing changes.

    The steps work on the mesh with merged seams. If no step changes the mesh, its seams are kept. Only a seam
    that is caused by a missing attribute, such as normals, is merged.

    Parameters
    ----------
    buffers, domains : mapping
        `buffers` has `positions`, `indices` and all other buffers. `domains` has the domain of each buffer:
        "vertex", "face", "corner" or "global".
    level : int, optional
        The level of DiffSoup's lattice.
    weights : (F,) numbers, optional
        The importance of each face for `debris` and `drop`. Default: the face's area.
    first : Change, optional
        A change to apply before the plan, such as removing hidden faces.
    trained : bool
        True if the mesh was trained by a method. In a trained soup, corners coincide only by chance.

    Raises
    ------
    AssetError
        `TRIASSET_EMPTY`: no face is left.
    """
    plan = options.plan
    points, faces = mesh_arrays(buffers["positions"], buffers["indices"])
    if weights is not None:
        weights = np.asarray(weights)
        if weights.shape != (len(faces),) or not (np.isfinite(weights) & (weights >= 0)).all():
            text = f"weights must be {len(faces)} finite numbers, one per face, and not negative"
            raise UsageError("USAGE", text)
    # Audit the original mesh, and merge the vertices that are split at seams.
    attributes = seam_attributes(buffers, domains, triangle_list=not trained)
    before, _ = audit_arrays(points, faces, attributes=attributes)
    seams = find_seams(points, faces, attributes) if first is None else None
    # Drop the seam keys of attributes that are missing in the result.
    buffers = {name: values for name, values in buffers.items() if name != SEAM_KEY}
    domains = {name: domain for name, domain in domains.items() if name != SEAM_KEY}
    carried, new_domains = _move_to_corners(buffers, domains, seams)
    state = _State(
        carried,
        new_domains,
        level,
        unchanged(faces, len(points)),
        np.arange(len(points)),
        np.arange(len(faces)),
        np.zeros(len(faces), bool),
        points,
        weights,
    )
    if seams is not None:
        first = with_vertices(seams.merged(faces), seams.first)
    state.apply(first or unchanged(faces, len(points)))
    dropped = _drop_nonfinite(state)
    # Run the steps. Repetitions that change nothing are not reported.
    for name in _order_steps(plan, state, options.peer):
        state.run_step(name, lambda name=name: _compute_change(name, state, options))  # type: ignore[misc]
    if len(faces) and not len(state.face_map):
        raise AssetError("TRIASSET_EMPTY", f"the plan {','.join(plan)} would remove all faces")
    steps = [step for turn, step in enumerate(state.steps) if turn < len(plan) or step.changed]
    kept = seams is None or not seams.unexplained
    changed = dropped or any(step.changed for step in steps)
    if (first is None or seams is not None) and kept and not changed:
        same = (np.arange(len(points)), np.arange(len(faces)), np.zeros(len(faces), bool))
        return Outcome(buffers, domains, *same, tuple(steps), before, before)
    if seams is not None:
        vertices = "vertex was" if seams.doubles == 1 else "vertices were"
        by_corner = "; UVs are stored per corner now" if new_domains.get("uv") == "corner" else ""
        note = f"{seams.doubles:,} {vertices} merged at seams{by_corner}"
        steps[0] = replace(steps[0], notes=(note, *steps[0].notes))
    if dropped:
        steps[0] = replace(steps[0], notes=(dropped, *steps[0].notes))
    # Audit the result.
    state.flush()
    attributes = seam_attributes(state.buffers, new_domains, triangle_list=not trained)
    after, _ = audit_arrays(state.points, state.pending.faces, attributes=attributes)
    maps = (state.vertex_map.astype(np.int64), state.face_map.astype(np.int64), state.turned)
    return Outcome(state.buffers, new_domains, *maps, tuple(steps), before, after)


def _move_to_corners(
    buffers: Buffers, domains: Mapping[str, Domain], seams: Seams | None
) -> tuple[Buffers, Mapping[str, Domain]]:
    """Return the buffers and their domains. If vertices are merged, vertex values become corner values.

    Colours are stored per corner if they differ at a seam. UVs are always stored per corner, so that merging
    vertices or filling a hole cannot distort the texture.
    """
    attributes = seam_attributes(buffers, domains)
    names = [
        name
        for name, values in attributes.items()
        if name == "uv"
        or (name == "color" and seams is not None and (values[seams.first][seams.number] != values).any())
    ]
    corners = buffers["indices"].reshape(-1)
    by_corner: dict[str, Domain] = dict.fromkeys(names, "corner")
    return {**buffers, **{name: buffers[name][corners] for name in names}}, {**domains, **by_corner}


def _order_steps(plan: Sequence[str], state: _State, peer: str | None) -> Iterator[str]:
    """Yield all steps of the plan, then repeat steps that earlier changes may affect.

    `weld` runs only once, because a second run would merge vertices that other steps have split.
    """
    again = [name for name in plan if name != "weld"]
    by_peer = BY_PEER.get(peer or "", ())
    waiting: set[str] = set()
    for turn in range(1 + _MAX_ROUNDS):
        for name in again if turn else plan:
            if turn and name not in waiting:
                continue
            waiting.discard(name)
            yield name
            if state.steps[-1].changed:
                waiting |= {
                    other for other in again if other in by_peer or name not in _UNTOUCHED_BY.get(other, ())
                }
        if not waiting:
            return


def _drop_nonfinite(state: _State) -> str:
    """Drop faces without a finite area, and vertices with coordinates that are not finite.

    Return a note about the dropped faces and vertices, or "".
    """
    points, faces = state.points, state.pending.faces
    keep = face_areas(points, faces)[1] & np.isfinite(points).all(axis=1)[faces].all(axis=1)
    used = np.isfinite(points).all(axis=1)
    if keep.all() and used.all():
        return ""
    if len(faces) and not keep.any():
        text = f"no face has finite coordinates; the first invalid vertex is {int(np.argmin(used))}"
        raise MeshError("MESH_NONFINITE", text, pointer=f"vertices[{int(np.argmin(used))}]")
    state.apply(with_faces(faces, keep, len(points), lost=~used))
    count, first = len(keep) - int(keep.sum()), int(np.argmin(keep))
    if not count:
        return "unused vertices with coordinates that are not finite were dropped"
    are = "face has" if count == 1 else "faces have"
    return f"{count:,} {are} NaN, infinite or too large coordinates; dropped (the first one: face {first})"


def list_defects(after: Audit, split: str | None = None) -> list[str]:
    """Return a description of each remaining kind of defect.

    If the file format splits shared vertices, `split` gives the reason.
    """
    after = after.judged
    counts, left = after.counts, []
    hint = 'add "close" to the plan to fill holes'
    if counts.all_apart:
        hint = 'faces share no vertices; add "weld" to the plan to merge them'
        if not after.corners_coincide:
            hint = "faces share no vertices, and no two corners coincide, so weld cannot merge them"
    elif after.closed_once_merged or is_worth_merging(after):
        hint = f'add "{judge(after).plan.partition(",")[0]}" to the plan to merge vertices'
    if split is not None:
        hint = f"faces share no vertices: {split}"
    for key, singular, plural, text in (
        ("nonmanifold_edges", "edge", "edges", " of more than two faces"),
        ("nonmanifold_vertices", "non-manifold vertex", "non-manifold vertices", ""),
        ("boundary_edges", "boundary edge", "boundary edges", f" ({hint})"),
        ("duplicate_faces", "duplicate face", "duplicate faces", ' (add "dedupe" to the plan)'),
        ("inconsistent_winding_edges", "edge", "edges", " between faces of opposite winding"),
        ("repeated_index_faces", "face that uses", "faces that use", " a vertex twice"),
    ):
        if number := getattr(counts, key):
            left.append(f"{number:,} {singular if number == 1 else plural}{text}")
    return left


def _compute_change(name: str, state: _State, options: Options) -> Change:
    """Return the change of the step `name` for the current mesh."""
    points, faces = state.points, state.pending.faces
    if options.peer is not None and name in BY_PEER[options.peer]:
        from msb.topology.crosscheck.repairs import repair_by_peer

        return repair_by_peer(options.peer, name, points, faces, options.limits)
    least, most = int(options.debris_faces), int(options.close_edges)
    steps: dict[str, Callable[[], Change]] = {
        "orient": lambda: orient(faces, len(points), only_turn=bool(_RESOLVING.intersection(options.plan))),
        "cut": lambda: cut(faces, len(points)),
        "pair": lambda: pair(points, faces, color_weight=options.pair_color, **state.colors()),
        "drop": lambda: drop(points, faces, weights=state.weights),
        "weld": lambda: weld(points, faces, options.weld),
        "debris": lambda: debris(
            points, faces, least_faces=least, least_share=options.debris_share, weights=state.weights
        ),
        "close": lambda: close(points, faces, most_edges=most, most_share=options.close_share),
        "dedupe": lambda: dedupe(faces, len(points)),
        "outward": lambda: outward(points, faces),
    }
    return steps[name]()
