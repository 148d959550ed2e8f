"""The parts of a record that other commands write as documents: an audit, trials, repairs, a distance.

Each model has the keys of its writer's `to_dict`, in their order; where the writer has a dataclass of plain
numbers, that is the model.
"""

from __future__ import annotations

from dataclasses import asdict
from math import inf
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from msb.bench.checked import Amount, Count, Record
from msb.metrics.images import most_psnr
from msb.scenes.checks import MAX_PIXELS
from msb.topology.audit import Metrics
from msb.topology.findings import Counts
from msb.topology.verdict import Level
from msb.trial.task import Outcome

STORED = "as stored"
"""The strategy of the mesh itself, which comes first."""
Decibels = Annotated[float, Field(ge=0, le=most_psnr(MAX_PIXELS))]
_MOST_SHARE = 1 + 1e-9  # sums of areas are rounded
Share = Annotated[float, Field(ge=0, le=_MOST_SHARE)]


class AuditVerdict(Record):
    """The verdict on a mesh, and why."""

    level: Level
    sentence: str


class AuditDocument(Record):
    """What `msb audit --json` writes (`msb.topology.audit.Audit.to_dict`)."""

    schema_: Literal["msb.audit/1"] = Field(alias="schema")
    path: str | None
    method: str | None
    topology: Literal["triangle_soup", "indexed_mesh"]
    is_soup: bool
    verdict: AuditVerdict
    counts: Counts
    metrics: Metrics
    variants: dict[str, dict[str, int]]
    winding_consistent: bool
    valence_histogram: dict[str, int]
    samples: dict[str, list[dict[str, Any]]]
    welded: dict[str, Any] | None
    without_seams: dict[str, Any] | None = None
    cross_check: list[dict[str, Any]] | None
    timings_ms: dict[str, float]
    computed_by: str

    @field_validator("counts", "metrics")
    @classmethod
    def _are_possible(cls, found: Counts | Metrics) -> Counts | Metrics:
        for name, value in asdict(found).items():
            # V/F is no share: a mesh may have more vertices than faces.
            most = _MOST_SHARE if name.endswith("_ratio") and name != "vf_ratio" else inf
            if value is not None and name != "euler_characteristic" and not 0 <= value <= most:
                raise ValueError(f"no mesh has {name} {value:g}")
        return found


class TrialEntry(Record):
    """What became of one task (`msb.trial.run.Trial`)."""

    task: str
    title: str
    outcome: Outcome
    why: str | None
    seconds: Amount
    numbers: dict[str, Any]
    libraries: dict[str, str]
    says: str
    files: tuple[str, ...]
    picture: str | None


class TrialDocument(Record):
    """What `msb trial --json` writes (`msb.trial.run.Trials.to_dict`)."""

    schema_: Literal["msb.trial/1"] = Field(alias="schema")
    path: str | None
    trials: tuple[TrialEntry, ...]
    mesh: dict[str, Any]
    limits: dict[str, float | None]
    cameras: dict[str, Any]


class Look(Record):
    """How a repaired asset looks on a tier, beside the original (`msb.trial.repairs.Look`)."""

    psnr: Decibels | None
    same: bool
    why: str | None


class Looks(Record):
    """Tier -> the look on it."""

    standard: Look
    dedicated: Look


class OwnPsnr(Record):
    """How near a bake comes to the model's own look (`msb.bake.report.Psnr`)."""

    before: Decibels | None
    after: Decibels
    after_16: Decibels


class PhotographsPsnr(Record):
    """How near the model and a bake of it come to the photographs (`msb.bake.report.Psnr`)."""

    dedicated: Decibels | None
    before: Decibels | None
    after: Decibels
    after_16: Decibels


class BakePsnr(Record):
    """The two, each None where there is nothing to compare with."""

    own: OwnPsnr | None
    photographs: PhotographsPsnr | None


class BakeDocument(Record):
    """What `msb bake --json` writes (`msb.bake.report.Report.to_dict`)."""

    schema_: Literal["msb.bake/1"] = Field(alias="schema")
    path: str | None
    output: str | None
    geometry: Literal["kept", "fitted", "surface"]
    color: Literal["texture", "vertex"]
    vertices: Count
    faces: Count
    texture: tuple[int, int] | None
    bytes: Count | None
    seconds: Amount
    views: dict[str, Any]
    unseen_area: Share
    psnr: BakePsnr
    verdict_before: AuditVerdict
    verdict_after: AuditVerdict
    lods: tuple[dict[str, Any], ...]
    collision: dict[str, Any] | None
    teacher: str
    model_faces: Count
    background: tuple[float, float, float]
    seed: int
    device: str
    tried: dict[str, float]
    notes: tuple[str, ...]
    sentence: str


class _Way(Record):
    strategy: str
    plan: tuple[str, ...]
    peer: str | None


class FailedStrategy(_Way):
    """A way to repair that failed, and why."""

    why: str


class Strategy(_Way):
    """What a way to repair makes of the asset (`msb.trial.repairs.Row.to_dict`)."""

    why: None
    faces_kept: Count
    faces_added: Count
    edges_cut: Count
    vertices: Count
    components: Count
    boundary_edge_ratio: Share | None
    nonmanifold_edges: Count
    nonmanifold_vertices: Count
    inconsistent_winding_edges: Count
    verdict_before: Level
    verdict_after: Level
    looks: Looks
    trials: dict[str, Outcome]
    trials_passed_before: Count
    trials_passed_after: Count
    bytes: Count
    seconds: Amount
    picture: str | None


def _kind(row: Any) -> str:
    """Return which of the two kinds of strategies JSON data, or a model, is."""
    why = row.get("why") if isinstance(row, dict) else getattr(row, "why", None)
    return "made" if why is None else "failed"


class RepairDocument(Record):
    """What `msb repair --compare --json` writes (`msb.trial.repairs.document`)."""

    schema_: Literal["msb.repair_compare/1"] = Field(alias="schema")
    path: str | None
    views: str
    strategies: tuple[
        Annotated[
            Annotated[Strategy, Tag("made")] | Annotated[FailedStrategy, Tag("failed")], Discriminator(_kind)
        ],
        ...,
    ]

    @field_validator("strategies")
    @classmethod
    def _begin_with_the_mesh_itself(
        cls, rows: tuple[Strategy | FailedStrategy, ...]
    ) -> tuple[Strategy | FailedStrategy, ...]:
        if not rows or rows[0].strategy != STORED or not isinstance(rows[0], Strategy):
            raise ValueError(f'the first strategy must be "{STORED}"')
        return rows

    @property
    def made(self) -> list[Strategy]:
        """The strategies that did not fail; the first is the mesh itself."""
        return [row for row in self.strategies if isinstance(row, Strategy)]


class ChamferDocument(Record):
    """What `msb.metrics.chamfer_surface` returns, with the scan, the metric and the mesh's file."""

    mean_d2s: Amount | None
    mean_s2d: Amount | None
    overall: Amount | None
    reason: str | None
    n_down: Count
    n_inbound: Count
    n_grid_in: Count
    n_in_obs: Count
    n_stl: Count
    n_stl_above: Count
    n_d2s_lt_max: Count
    n_s2d_lt_max: Count
    n_vertices: Count
    n_faces_nonzero: Count
    n_sampled: Count
    seed: Count
    scan: Count
    metric: dict[str, Any]
    mesh: str


class WalkDocument(Record):
    """What a walk off the path of the capture shows of a condition (`msb.bench.walk`)."""

    frames: Count
    width: Count
    height: Count
    flicker: Amount
    """Root mean square in levels of 255 of `msb.metrics.steadiness.unexplained_change` over all frames."""
    flicker_worst: Amount
    """The same over the worst second."""
    worst_frame: Count
    """The number of its first frame; the walk begins with 0."""
    holes: Share
    """Pixels of `msb.metrics.steadiness.holes` as a share of those that show the model or are such."""
    film: str | None
    """The file of the worst second, beside the record; None without the extra `video`."""
    seconds: Amount
