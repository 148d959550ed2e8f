"""What a worker is told: one cell, the parts of it to compute, and all they need. Plain data, to be sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from msb.bench.folder import Results
from msb.bench.records import TIER_OF

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from msb.bench.models import Model
    from msb.bench.photographs import SceneAt, Views
    from msb.bench.records import Cell, Reason, Status
    from msb.methods import Tier

Part = Literal["quality", "audit", "timing", "chamfer", "training"]
MAIN: tuple[Part, ...] = ("quality", "audit")
"""Without these a cell has failed; the others leave a reason."""
Inputs = dict[str, str]
"""What decides a part: name -> hash or version."""


@dataclass(frozen=True)
class Job:
    """One cell to be computed, or a part of it.

    Attributes
    ----------
    root, run
        The results folder, and the run's id.
    cell : Cell
    scene, views
        Where the scene is, and what it was when the run was planned.
    parts : mapping of Part to Inputs
        What is to be computed, and what is then on record as its inputs. Other parts of a record stay.
    model : Model, optional
        None where there are official renderings only.
    settings : mapping
        Overrides of the asset's.
    renders : Path, optional
        Folder of official renderings; None: our reference renderer.
    training, mesh : Path, optional
    device : str, optional
    vgg_weights : Path, optional
    frames, seconds
        Of the timing.
    chamfer_data : Path, optional
    chamfer_seed : int
    """

    root: Path
    run: str
    cell: Cell
    scene: SceneAt
    views: Views
    parts: Mapping[Part, Inputs]
    model: Model | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    renders: Path | None = None
    training: Path | None = None
    mesh: Path | None = None
    device: str | None = None
    vgg_weights: Path | None = None
    frames: int = 0
    seconds: float = 0.0
    chamfer_data: Path | None = None
    chamfer_seed: int = 0

    @property
    def name(self) -> str:
        """What progress shows."""
        return " ".join((self.cell.dataset, self.cell.scene, self.cell.method, self.cell.condition_name))

    @property
    def folder(self) -> Path:
        """The cell's."""
        return Results(self.root).cell(self.cell)

    @property
    def photographs(self) -> Path:
        """The folder with the ground truth."""
        return Results(self.root).ground_truth(self.cell.dataset, self.cell.scene, self.views.photographs)

    @property
    def tier(self) -> Tier:
        """The tier the cell's images are of."""
        return TIER_OF[self.cell.condition]


@dataclass(frozen=True)
class Done:
    """What came of a job.

    Attributes
    ----------
    cell : Cell
    status : Status
    reasons : mapping of str to Reason
        Part -> why it is not there.
    seconds : float
        The job took.
    """

    cell: Cell
    status: Status
    reasons: Mapping[str, Reason]
    seconds: float
