"""Run the steps of a plan until none of them changes anything, and say what is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import static_colors
from msb.errors import AssetError, MeshError, UsageError
from msb.repair.buffers import carry
from msb.repair.plan import BY_PEER
from msb.topology import audit_arrays
from msb.topology.arrays import mesh_arrays
from msb.topology.halfedge import NONE
from msb.topology.seams import find_seams, seam_attributes
from msb.topology.steps import close, cut, debris, drop, orient, pair, weld
from msb.topology.steps.change import followed_by, unchanged, with_vertices
from msb.topology.steps.cut import cut_edges

if TYPE_CHECKING:
    from msb.asset.manifest import Domain
    from msb.repair.plan import Options
    from msb.topology import Audit
    from msb.topology.seams import Seams
    from msb.topology.steps import Change

    Buffers = Mapping[str, NDArray[Any]]

# Step -> steps whose changes give it no new work, if it had none before. A turned face stays in its
# place, debris goes as whole components, and no step finds more to do in its own result. Where `orient`
# cuts a one-sided surface, a component may fall apart.
_UNTOUCHED_BY = {
    "orient": ("orient", "debris"),
    **dict.fromkeys(("pair", "cut"), ("pair", "cut", "orient", "debris")),
    "drop": ("drop", "orient", "debris"),
    "debris": ("debris",),
}
# Steps after which no edge has more than two faces. `orient` lets them choose which faces stay together.
_PARTING = frozenset({"pair", "cut", "drop"})
_MOST_ROUNDS = 16


@dataclass(frozen=True)
class Step:
    """One step that was done. Counts are of rows; `notes` are sentences without a full stop."""

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
        """Faces removed, added and turned, vertices removed and added."""
        faces = (self.faces_removed, self.faces_added, self.faces_turned)
        return (*faces, self.vertices_removed, self.vertices_added)

    @property
    def changed(self) -> bool:
        """Whether anything is different after it."""
        return any(self.counts)

    def to_dict(self) -> dict[str, Any]:
        """Return the step as JSON data."""
        return {**vars(self), "notes": list(self.notes)}


@dataclass(frozen=True, eq=False)
class Outcome:
    """A repaired mesh: its buffers, what was done, and where rows are from.

    Maps have the row of the original that each new vertex (V',) and face (F',) is, -1 for what is new;
    `turned` (F',) says whether the second and the third corner of a face changed places. `domains` are those
    of the buffers: UVs are by corner where anything was changed.
    """

    buffers: Buffers
    domains: Mapping[str, Domain]
    vertex_map: NDArray[np.int64]
    face_map: NDArray[np.int64]
    turned: NDArray[np.bool_]
    steps: tuple[Step, ...]
    before: Audit
    after: Audit

    @cached_property
    def cut_edges(self) -> NDArray[Any]:
        """(n, 2) vertices of the original whose edge became several."""
        return cut_edges(mesh_arrays(self.buffers["positions"], self.buffers["indices"])[1], self.vertex_map)


@dataclass
class _Work:
    """The mesh as it is after the steps done so far."""

    buffers: Buffers
    domains: Mapping[str, Domain]
    level: int | None
    # What has happened since `buffers` were carried. Nothing in it is new.
    pending: Change
    vertex_map: NDArray[Any]
    face_map: NDArray[Any]
    turned: NDArray[np.bool_]
    points: NDArray[Any]
    weights: NDArray[Any] | None
    steps: list[Step] = field(default_factory=list)

    def do(self, name: str, make: Callable[[], Change]) -> bool:
        """Do a step; return whether it changed anything."""
        start = time.perf_counter()
        change = make()
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
        return done.changed

    def apply(self, change: Change) -> None:
        """Carry the maps, and the buffers where values are new; of other changes only the sum is kept."""
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
        """Carry the buffers through what is pending."""
        self.buffers = carry(self.buffers, self.domains, self.pending, self.level)
        self.pending = unchanged(self.pending.faces, len(self.pending.vertex_map))

    def colors(self) -> dict[str, NDArray[Any]]:
        """Return the static colours as `pair` takes them; corners' colours are left out of account."""
        shown = static_colors(self.buffers, self.domains)
        if shown is None or shown.domain == "corner":
            return {}
        rows = self.pending.vertex_map if shown.domain == "vertex" else self.pending.face_map
        values = shown.values[rows, :3]
        return {f"{shown.domain}_colors": values / 255 if values.dtype == np.uint8 else values}


def run_plan(
    buffers: Buffers,
    domains: Mapping[str, Domain],
    options: Options,
    *,
    level: int | None = None,
    weights: NDArray[Any] | None = None,
    first: Change | None = None,
) -> Outcome:
    """Repair a mesh: the steps of the plan in turn, again and again until none changes anything (weld once).

    `buffers` are `positions`, `indices` and all others, `domains` "vertex", "face", "corner" or "global";
    `level` is that of DiffSoup's lattice. `weights` (F,) are what each face counts to `debris` and `drop`;
    the area if not given. The change `first` comes before the plan, such as leaving out hidden faces. The
    steps are done on the mesh without its seams, and what changes nothing leaves these as they are. A plan
    that leaves no face is refused: `TRIASSET_EMPTY`.
    """
    plan = options.plan
    points, faces = mesh_arrays(buffers["positions"], buffers["indices"])
    refuse_nonfinite(points)
    if weights is not None:
        weights = np.asarray(weights)
        if weights.shape != (len(faces),) or not (np.isfinite(weights) & (weights >= 0)).all():
            text = f"weights must be a finite number, 0 or more, for each of {len(faces)} faces"
            raise UsageError("USAGE", text)
    attributes = seam_attributes(buffers, domains)
    before, _ = audit_arrays(points, faces, attributes=attributes)
    seams = find_seams(points, faces, attributes) if first is None else None
    held, held_by = _without_doubles(buffers, domains, seams)
    work = _Work(
        held,
        held_by,
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
    work.apply(first or unchanged(faces, len(points)))
    for name in _turns(plan, work, options.peer):
        work.do(name, lambda name=name: _step(name, work, options))  # type: ignore[misc]
    if len(faces) and not len(work.face_map):
        raise AssetError("TRIASSET_EMPTY", f"the plan {','.join(plan)} would remove every piece")
    shown = [step for turn, step in enumerate(work.steps) if turn < len(plan) or step.changed]
    if (first is None or seams is not None) and not any(step.changed for step in shown):
        same = (np.arange(len(points)), np.arange(len(faces)), np.zeros(len(faces), bool))
        return Outcome(buffers, domains, *same, tuple(shown), before, before)
    if seams is not None:
        doubled = "vertex is" if seams.doubles == 1 else "vertices are"
        note = f"without its seams, at which {seams.doubles:,} {doubled} doubled: UVs are by corner now"
        shown[0] = replace(shown[0], notes=(note, *shown[0].notes))
    work.flush()
    after, _ = audit_arrays(
        work.points, work.pending.faces, attributes=seam_attributes(work.buffers, held_by)
    )
    maps = (work.vertex_map.astype(np.int64), work.face_map.astype(np.int64), work.turned)
    return Outcome(work.buffers, held_by, *maps, tuple(shown), before, after)


def _without_doubles(
    buffers: Buffers, domains: Mapping[str, Domain], seams: Seams | None
) -> tuple[Buffers, Mapping[str, Domain]]:
    """Return the buffers with that by corner which merged vertices cannot hold, and their domains.

    UVs are so in any case: whatever else is merged, or added over a hole, must not stretch a texture.
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


def _turns(plan: Sequence[str], work: _Work, peer: str | None) -> Iterator[str]:
    """Yield the steps in turn, as long as one has changed something that could give another one work.

    Vertices are welded in the first turn only: later ones would undo what was cut.
    """
    again = [name for name in plan if name != "weld"]
    by_peer = BY_PEER.get(peer or "", ())
    waiting: set[str] = set()
    for turn in range(1 + _MOST_ROUNDS):
        for name in again if turn else plan:
            if turn and name not in waiting:
                continue
            waiting.discard(name)
            yield name
            if work.steps[-1].changed:
                waiting |= {
                    other for other in again if other in by_peer or name not in _UNTOUCHED_BY.get(other, ())
                }
        if not waiting:
            return


def refuse_nonfinite(points: NDArray[Any]) -> None:
    """Refuse positions that are not finite."""
    finite = np.isfinite(points)
    if not finite.all():
        row = int(np.argmin(finite.all(axis=1)))
        text = f"vertex {row} is {points[row].tolist()}; a repair needs finite coordinates"
        raise MeshError("MESH_NONFINITE", text, pointer=f"vertices[{row}]")


def what_is_left(after: Audit, split: str | None = None) -> list[str]:
    """Return what still keeps a mesh from being manifold, consistently wound and free of doubles.

    `split` says why a file does not share the vertices that the repaired mesh shares, if it does not.
    """
    after = after.judged
    counts, left = after.counts, []
    why = "open stays open unless close fills holes"
    if counts.all_apart:
        why = "a soup stays one unless weld merges vertices"
        if not after.corners_coincide:
            why = "a soup stays one, because no two of its corners coincide"
    if split is not None:
        why = f"the file is a soup, because {split}"
    for key, one, many, text in (
        ("nonmanifold_edges", "edge", "edges", " of more than two faces"),
        ("nonmanifold_vertices", "non-manifold vertex", "non-manifold vertices", ""),
        ("boundary_edges", "boundary edge", "boundary edges", f": {why}"),
        ("duplicate_faces", "face that repeats another", "faces that repeat another", ""),
        ("inconsistent_winding_edges", "edge", "edges", " across which the winding flips"),
        ("repeated_index_faces", "face that names", "faces that name", " a vertex twice"),
    ):
        if number := getattr(counts, key):
            left.append(f"{number:,} {one if number == 1 else many}{text}")
    return left


def _step(name: str, work: _Work, options: Options) -> Change:
    points, faces = work.points, work.pending.faces
    if options.peer is not None and name in BY_PEER[options.peer]:
        from msb.topology.crosscheck.repairs import repair_by_peer

        return repair_by_peer(options.peer, name, points, faces, options.limits)
    least, most = int(options.debris_faces), int(options.close_edges)
    steps: dict[str, Callable[[], Change]] = {
        "orient": lambda: orient(faces, len(points), only_turn=bool(_PARTING.intersection(options.plan))),
        "cut": lambda: cut(faces, len(points)),
        "pair": lambda: pair(points, faces, color_weight=options.pair_color, **work.colors()),
        "drop": lambda: drop(points, faces, weights=work.weights),
        "weld": lambda: weld(points, faces, options.weld),
        "debris": lambda: debris(
            points, faces, least_faces=least, least_share=options.debris_share, weights=work.weights
        ),
        "close": lambda: close(points, faces, most_edges=most, most_share=options.close_share),
    }
    return steps[name]()
