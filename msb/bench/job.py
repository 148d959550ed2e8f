"""Jobs for worker processes.

A job contains one benchmark cell, the parts to compute, and all their inputs, as plain data.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from msb.bench.folder import Results
from msb.bench.models import ModelAsset
from msb.bench.photographs import ViewState
from msb.bench.protocol_tables import ChamferTable, TimingTable, TrialTable, WalkTable
from msb.bench.records import TIER_OF, Cell, Status
from msb.registry import Tier
from msb.scenes.datasets import SceneAt

PartName = Literal[
    "quality", "audit", "trial", "repairs", "timing", "walk", "chamfer", "training", "renderer_timing"
]
# A benchmark cell fails if one of the required parts fails. If another part fails, the record states the
# reason.
MAIN: tuple[PartName, ...] = ("quality", "audit")
# For each part, the hash or version of each input. The keys are names of inputs.
PartInputs = dict[str, str]


@dataclass(frozen=True)
class Job:
    """One benchmark cell, and the parts of the cell to compute."""

    root: Path
    run: str
    cell: Cell
    scene: SceneAt
    # The state of the scene when the run was planned.
    views: ViewState
    # For each part to compute, the inputs that are recorded. All other valid parts of the record are kept.
    parts: Mapping[PartName, PartInputs]
    # The current inputs of every part that the protocol requests for the benchmark cell.
    requested: Mapping[PartName, PartInputs] = field(default_factory=dict)
    # The model of the benchmark cell; None if the protocol has only official renderings of the method.
    model: ModelAsset | None = None
    # Values that replace settings of the asset.
    settings: Mapping[str, Any] = field(default_factory=dict)
    # The order and sampling options of a variant.
    options: Mapping[str, str] = field(default_factory=dict)
    # The folder of official renderings. If the value is None, our reference renderer is used.
    renders: Path | None = None
    training: Path | None = None
    mesh: Path | None = None
    renderer_timing: Path | None = None
    device: str | None = None
    vgg_weights: Path | None = None
    timing: TimingTable = field(default_factory=TimingTable)
    # The protocol's table [chamfer], with an absolute path of the evaluation data.
    chamfer: ChamferTable | None = None
    trial: TrialTable | None = None
    walk: WalkTable | None = None
    # Sentences about differences between training and evaluation, from `compare_training`.
    trained: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the job in progress lines."""
        return " ".join(self.cell.names)

    @property
    def folder(self) -> Path:
        """The folder of the benchmark cell."""
        return Results(self.root).cell(self.cell)

    @property
    def photographs(self) -> Path:
        """The folder of the ground truth."""
        return Results(self.root).ground_truth(self.cell.dataset, self.cell.scene, self.views.photographs)

    @property
    def tier(self) -> Tier:
        """The tier that renders the images of the benchmark cell."""
        return TIER_OF[self.cell.condition]


@dataclass(frozen=True)
class JobOutcome:
    """The status of a benchmark cell after a job, and the time of the job."""

    cell: Cell
    status: Status
    seconds: float
