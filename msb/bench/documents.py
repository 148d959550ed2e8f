"""The parts of a benchmark record that other commands write: audit, bake, trials, repairs and Chamfer
distance.

The record stores the output of other commands without changes. The models in this module declare only the
keys that are read for tables and reports. All other keys are kept unchanged, so that other commands may add
keys.
"""

from dataclasses import asdict
from math import inf
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, field_validator

from msb.bench.validation import Amount, Count, Record
from msb.metrics.images import find_max_psnr
from msb.scenes.checks import MAX_PIXELS
from msb.topology.audit import Metrics
from msb.topology.findings import Counts
from msb.topology.verdict import Level

# The first strategy in a comparison of repairs, which leaves the mesh unrepaired.
STORED = "as stored"
Decibels = Annotated[float, Field(ge=0, le=find_max_psnr(MAX_PIXELS))]
# Sums of areas have rounding errors, so a share of 100 % may be slightly larger than 1.
_MAX_SHARE = 1 + 1e-9
Share = Annotated[float, Field(ge=0, le=_MAX_SHARE)]
# The result of a trial task: works, works with limitations, fails, or was not run.
Outcome = Literal["works", "care", "fails", "not_run"]


class Document(Record):
    """The JSON document that another command wrote. Keys that the class does not declare are kept."""

    model_config = ConfigDict(extra="allow")


class AuditVerdict(Document):
    """The verdict on a mesh, and its reason."""

    level: Level
    sentence: str


class AuditDocument(Document):
    """The output of `msb audit --json`."""

    schema_: Literal["msb.audit/1"] = Field(alias="schema")
    verdict: AuditVerdict
    counts: Counts
    metrics: Metrics

    @field_validator("counts", "metrics")
    @classmethod
    def _check_ranges(cls, values: Counts | Metrics) -> Counts | Metrics:
        for name, value in asdict(values).items():
            # vf_ratio is vertices per face and may be larger than 1.
            most = _MAX_SHARE if name.endswith("_ratio") and name != "vf_ratio" else inf
            if value is not None and name != "euler_characteristic" and not 0 <= value <= most:
                raise ValueError(f"{name} {value:g} is out of range")
        return values


class TrialEntry(Document):
    """The result of one trial task."""

    task: str
    title: str
    outcome: Outcome
    why: str | None
    seconds: Amount
    says: str
    picture: str | None


class TrialDocument(Document):
    """The output of `msb trial --json`."""

    schema_: Literal["msb.trial/1"] = Field(alias="schema")
    trials: tuple[TrialEntry, ...]


class Psnr(Document):
    """PSNR in dB between renderings and photographs.

    The PSNR is measured before the bake, after the bake, and after the bake with 16 samples per pixel.
    """

    before: Decibels | None
    after: Decibels
    after_16: Decibels


class BakePsnr(Document):
    """The PSNR of a bake. The value is None without test photographs."""

    photographs: Psnr | None


class BakeDocument(Document):
    """The output of `msb bake --json`."""

    schema_: Literal["msb.bake/1"] = Field(alias="schema")
    geometry: Literal["kept", "fitted", "surface"]
    faces: Count
    seconds: Amount
    psnr: BakePsnr
    sentence: str


class TierSimilarity(Document):
    """The similarity of a repaired asset to the original on one tier."""

    psnr: Decibels | None
    same: bool
    why: str | None


class TierSimilarities(Document):
    """The similarity of a repaired asset to the original on each tier."""

    standard: TierSimilarity
    dedicated: TierSimilarity


class FailedStrategy(Document):
    """A repair strategy that failed, and the reason."""

    strategy: str
    why: str


class Strategy(Document):
    """The result of a repair strategy."""

    strategy: str
    plan: tuple[str, ...]
    peer: str | None
    why: None
    faces_kept: Count
    faces_added: Count
    edges_cut: Count
    components: Count
    verdict_after: Level
    looks: TierSimilarities
    trials: dict[str, Outcome]
    trials_passed_before: Count
    trials_passed_after: Count
    bytes: Count
    seconds: Amount
    picture: str | None


class RepairDocument(Document):
    """The output of `msb repair --compare --json`."""

    schema_: Literal["msb.repair_compare/1"] = Field(alias="schema")
    views: str
    strategies: tuple[Strategy | FailedStrategy, ...]

    @field_validator("strategies")
    @classmethod
    def _check_first(
        cls, rows: tuple[Strategy | FailedStrategy, ...]
    ) -> tuple[Strategy | FailedStrategy, ...]:
        if not rows or rows[0].strategy != STORED or not isinstance(rows[0], Strategy):
            raise ValueError(f'the first strategy must be "{STORED}"')
        return rows

    @property
    def succeeded(self) -> list[Strategy]:
        """The strategies that did not fail. The first strategy leaves the mesh unrepaired."""
        return [row for row in self.strategies if isinstance(row, Strategy)]


class ChamferDocument(Document):
    """The output of `msb.metrics.chamfer_surface`, with the scan, the metric and the file of the mesh."""

    overall: Amount | None
