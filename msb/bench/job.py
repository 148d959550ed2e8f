"""The orders to workers: one cell, the parts of it to compute, and all that they need, as plain data."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from msb.bench.folder import Results
from msb.bench.models import Model
from msb.bench.photographs import Views
from msb.bench.protocol_tables import ChamferTable, TimingTable, TrialTable, WalkTable
from msb.bench.records import TIER_OF, Cell, Status
from msb.registry import Tier
from msb.scenes.datasets import SceneAt

Part = Literal[
    "quality", "audit", "trial", "repairs", "timing", "walk", "chamfer", "training", "renderer_timing"
]
# Parts without which a cell has failed; any other missing part leaves a reason.
MAIN: tuple[Part, ...] = ("quality", "audit")
# The inputs that decide a part: name -> hash or version.
Inputs = dict[str, str]


@dataclass(frozen=True)
class Job:
    """One cell to be computed, or a part of it."""

    root: Path
    run: str
    cell: Cell
    scene: SceneAt
    # The scene's state when the run was planned.
    views: Views
    # The parts to compute, each with the inputs to record. Other parts of a record stay while they hold.
    parts: Mapping[Part, Inputs]
    # The present inputs of each part that the cell should have, whether it is computed now or not.
    wanted: Mapping[Part, Inputs] = field(default_factory=dict)
    # None where there are official renderings only.
    model: Model | None = None
    # Values that replace the asset's settings.
    settings: Mapping[str, Any] = field(default_factory=dict)
    # The order and sampling of a variant.
    options: Mapping[str, str] = field(default_factory=dict)
    # The folder of official renderings; None means our reference renderer.
    renders: Path | None = None
    training: Path | None = None
    mesh: Path | None = None
    renderer_timing: Path | None = None
    device: str | None = None
    vgg_weights: Path | None = None
    timing: TimingTable = field(default_factory=TimingTable)
    # Its path is absolute.
    chamfer: ChamferTable | None = None
    trial: TrialTable | None = None
    walk: WalkTable | None = None
    # What the model's training did otherwise, as `trained_otherwise` says it.
    trained: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What progress shows."""
        return " ".join(self.cell.names)

    @property
    def folder(self) -> Path:
        """The cell's folder."""
        return Results(self.root).cell(self.cell)

    @property
    def photographs(self) -> Path:
        """The folder with the ground truth."""
        return Results(self.root).ground_truth(self.cell.dataset, self.cell.scene, self.views.photographs)

    @property
    def tier(self) -> Tier:
        """The tier that draws the cell's images."""
        return TIER_OF[self.cell.condition]


@dataclass(frozen=True)
class Done:
    """The outcome of a job."""

    cell: Cell
    status: Status
    seconds: float
