"""The parts of a record that are documents of other commands: an audit, a bake, trials, repairs, a distance.

A document is stored as its writer's `to_dict` gives it. The models declare only the keys that tables and
reports read; all other keys are kept as they are. A new key of a writer needs no change here.
"""

from dataclasses import asdict
from math import inf
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, field_validator

from msb.bench.checked import Amount, Count, Record
from msb.metrics.images import most_psnr
from msb.scenes.checks import MAX_PIXELS
from msb.topology.audit import Metrics
from msb.topology.findings import Counts
from msb.topology.verdict import Level

# The strategy of the mesh itself, which comes first.
STORED = "as stored"
Decibels = Annotated[float, Field(ge=0, le=most_psnr(MAX_PIXELS))]
_MOST_SHARE = 1 + 1e-9  # sums of areas are rounded
Share = Annotated[float, Field(ge=0, le=_MOST_SHARE)]
# Result of a trial, as in documents of the schema msb.trial/1.
Outcome = Literal["works", "care", "fails", "not_run"]


class Document(Record):
    """A document of another command."""

    model_config = ConfigDict(extra="allow")


class AuditVerdict(Document):
    """The verdict on a mesh, and why."""

    level: Level
    sentence: str


class AuditDocument(Document):
    """Output of `msb audit --json`."""

    schema_: Literal["msb.audit/1"] = Field(alias="schema")
    verdict: AuditVerdict
    counts: Counts
    metrics: Metrics

    @field_validator("counts", "metrics")
    @classmethod
    def _are_possible(cls, found: Counts | Metrics) -> Counts | Metrics:
        for name, value in asdict(found).items():
            # V/F is no share: a mesh may have more vertices than faces.
            most = _MOST_SHARE if name.endswith("_ratio") and name != "vf_ratio" else inf
            if value is not None and name != "euler_characteristic" and not 0 <= value <= most:
                raise ValueError(f"no mesh has {name} {value:g}")
        return found


class TrialEntry(Document):
    """The result of one task."""

    task: str
    title: str
    outcome: Outcome
    why: str | None
    seconds: Amount
    says: str
    picture: str | None


class TrialDocument(Document):
    """Output of `msb trial --json`."""

    schema_: Literal["msb.trial/1"] = Field(alias="schema")
    trials: tuple[TrialEntry, ...]


class Psnr(Document):
    """Similarity of a bake's images to the photographs."""

    before: Decibels | None
    after: Decibels
    after_16: Decibels


class BakePsnr(Document):
    """Similarity of a bake; None without test photographs."""

    photographs: Psnr | None


class BakeDocument(Document):
    """Output of `msb bake --json`."""

    schema_: Literal["msb.bake/1"] = Field(alias="schema")
    geometry: Literal["kept", "fitted", "surface"]
    faces: Count
    seconds: Amount
    psnr: BakePsnr
    sentence: str


class Look(Document):
    """The similarity of a repaired asset to the original on one tier."""

    psnr: Decibels | None
    same: bool
    why: str | None


class Looks(Document):
    """Tier -> the look on it."""

    standard: Look
    dedicated: Look


class FailedStrategy(Document):
    """A way to repair that failed, and why."""

    strategy: str
    why: str


class Strategy(Document):
    """The result of a way to repair an asset."""

    strategy: str
    plan: tuple[str, ...]
    peer: str | None
    why: None
    faces_kept: Count
    faces_added: Count
    edges_cut: Count
    components: Count
    verdict_after: Level
    looks: Looks
    trials: dict[str, Outcome]
    trials_passed_before: Count
    trials_passed_after: Count
    bytes: Count
    seconds: Amount
    picture: str | None


class RepairDocument(Document):
    """Output of `msb repair --compare --json`."""

    schema_: Literal["msb.repair_compare/1"] = Field(alias="schema")
    views: str
    strategies: tuple[Strategy | FailedStrategy, ...]

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


class ChamferDocument(Document):
    """Output of `msb.metrics.chamfer_surface`, with the scan, the metric and the mesh's file."""

    overall: Amount | None
