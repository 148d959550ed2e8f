"""Try ways to repair an asset, and say of each what it keeps, what it costs and how long it takes."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from msb.asset.tiers import why_not
from msb.errors import MsbError
from msb.metrics import psnr
from msb.render import Renderer
from msb.render.backend import lean_options
from msb.repair.assets import Repaired, repair_asset
from msb.topology import audit_arrays
from msb.topology.halfedge import NONE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.methods import Tier
    from msb.repair.plan import Options
    from msb.scenes import Camera
    from msb.topology import Audit

    Images = list[NDArray[np.float32]]

TIERS: tuple[Tier, ...] = ("standard", "dedicated")
STORED = "as stored"
"""The row of the asset itself."""
STRATEGIES: dict[str, tuple[tuple[str, ...], str | None]] = {
    "orient,pair": (("orient", "pair"), None),
    "orient,cut": (("orient", "cut"), None),
    "drop,orient": (("drop", "orient"), None),
    "orient,pair,close": (("orient", "pair", "close"), None),
    "orient,pair,debris": (("orient", "pair", "debris"), None),
    "cut by igl": (("cut",), "igl"),
    "drop by pymeshlab": (("drop",), "pymeshlab"),
}
"""Name of the row -> plan, and the peer that does the step in our stead."""


@dataclass(frozen=True)
class Look:
    """How a repaired asset looks on one tier, beside the original.

    Attributes
    ----------
    psnr : float or None
        dB, of the mean squared error over all views of 8-bit images; None where `same`, or not drawn.
    same : bool
        Whether every pixel of every view is the same.
    why : str or None
        Why there is no picture.
    """

    psnr: float | None = None
    same: bool = False
    why: str | None = None


@dataclass(frozen=True, eq=False)
class Row:
    """What a strategy makes of the asset; `why` says that it failed, and then there is nothing else."""

    strategy: str
    plan: tuple[str, ...] = ()
    peer: str | None = None
    faces_kept: int = 0
    faces_added: int = 0
    edges_cut: int = 0
    before: Audit | None = None
    after: Audit | None = None
    looks: dict[Tier, Look] | None = None
    size: int = 0
    seconds: float = 0.0
    why: str | None = None
    repaired: Repaired | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the row as JSON data."""
        data: dict[str, Any] = {
            "strategy": self.strategy,
            "plan": list(self.plan),
            "peer": self.peer,
            "why": self.why,
        }
        if self.before is None or self.after is None or self.looks is None:
            return data
        counts, metrics = self.after.counts, self.after.metrics
        return {
            **data,
            "faces_kept": self.faces_kept,
            "faces_added": self.faces_added,
            "edges_cut": self.edges_cut,
            "vertices": counts.vertices,
            "components": counts.components,
            "boundary_edge_ratio": metrics.boundary_edge_ratio,
            "nonmanifold_edges": counts.nonmanifold_edges,
            "nonmanifold_vertices": counts.nonmanifold_vertices,
            "inconsistent_winding_edges": counts.inconsistent_winding_edges,
            "verdict_before": self.before.verdict,
            "verdict_after": self.after.verdict,
            "looks": {tier: dict(vars(look)) for tier, look in self.looks.items()},
            "bytes": self.size,
            "seconds": self.seconds,
        }


def compare(
    asset: Asset,
    cameras: Sequence[Camera],
    options: Options,
    *,
    plan: tuple[str, ...] | None = None,
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Return a row for the asset as stored, and one for each strategy.

    Parameters
    ----------
    asset : Asset
    cameras : sequence of Camera
        The views over which looks are compared.
    options : Options
        Numbers of the steps, and limits of the peers.
    plan : tuple of str, optional
        One more strategy.
    device : str, optional
    step : callable
        Called after each row; there is one for each strategy, one for `plan`, and one more.
    """
    originals = {tier: _draw(asset, tier, cameras, device) for tier in TIERS}
    audit, _ = audit_arrays(asset.buffers["positions"], asset.buffers["indices"])
    unchanged = {tier: _look(found, found) for tier, found in originals.items()}
    faces, size = asset.manifest.face_count, _size(asset)
    rows = [Row(STORED, faces_kept=faces, before=audit, after=audit, looks=unchanged, size=size)]
    step()
    strategies = dict(STRATEGIES)
    if plan is not None:
        strategies.setdefault(",".join(plan), (plan, None))
    for name, (steps, peer) in strategies.items():
        start = time.perf_counter()
        try:
            done = repair_asset(asset, steps, replace(options, peer=peer))
        except MsbError as error:
            rows.append(Row(name, steps, peer, why=f"{error.code}: {error.message}"))
            step()
            continue
        seconds = time.perf_counter() - start
        drawn = {tier: _draw(done.asset, tier, cameras, device) for tier in TIERS}
        kept = int((done.face_map != NONE).sum())
        rows.append(
            Row(
                name,
                steps,
                peer,
                kept,
                len(done.face_map) - kept,
                len(done.cut_edges),
                done.before,
                done.after,
                {tier: _look(originals[tier], found) for tier, found in drawn.items()},
                _size(done.asset),
                seconds,
                repaired=done,
            )
        )
        step()
    return rows


def _draw(asset: Asset, tier: Tier, cameras: Sequence[Camera], device: str | None) -> Images | str:
    """Return the images of a tier, or why there are none."""
    why = why_not(asset.manifest, tier)
    if why is not None:
        return why
    try:
        with Renderer(asset, tier=tier, device=device, **lean_options(tier, None)) as renderer:
            return [renderer.render(camera).image for camera in cameras]
    except MsbError as error:
        return f"{error.code}: {error.message}"


def _look(original: Images | str, repaired: Images | str) -> Look:
    if isinstance(original, str) or isinstance(repaired, str):
        return Look(why=original if isinstance(original, str) else str(repaired))
    errors = [10 ** (-psnr(now, was) / 10) for was, now in zip(original, repaired, strict=True)]
    mean = sum(errors) / len(errors)
    return Look(same=True) if mean == 0 else Look(-10 * math.log10(mean))


def _size(asset: Asset) -> int:
    return sum(spec.byte_length for spec in asset.manifest.buffers.values())
