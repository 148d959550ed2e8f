"""Try ways to repair an asset, and say of each what it keeps, what it costs and how long it takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.api.auditing import audit_stored
from msb.api.opening import stored_mesh
from msb.asset.tiers import why_not
from msb.base.children import check_room
from msb.base.limits import Limits
from msb.errors import MsbError, OutputError
from msb.render import Renderer
from msb.render.backend import lean_options
from msb.render.images import to_bytes
from msb.repair.assets import repair_asset
from msb.repair.pictures import keep_picture
from msb.topology.halfedge import NONE
from msb.trial.renderings import BACKGROUND, likeness
from msb.trial.run import try_asset
from msb.views import choose_views

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.base.limits import Limits
    from msb.registry import Tier
    from msb.repair.assets import Repaired
    from msb.repair.plan import Options, Peer
    from msb.scenes import Camera
    from msb.topology import Audit
    from msb.trial.run import Trial
    from msb.views import Views

    Images = list[NDArray[np.uint8]]

SCHEMA = "msb.repair_compare/1"
TIERS: tuple[Tier, ...] = ("standard", "dedicated")
# The row of the asset itself.
STORED = "as stored"
# Name of the row -> plan, and the peer that does the step in our stead.
STRATEGIES: dict[str, tuple[tuple[str, ...], Peer | None]] = {
    "orient,pair": (("orient", "pair"), None),
    "orient,cut": (("orient", "cut"), None),
    "weld,orient,pair": (("weld", "orient", "pair"), None),
    "drop,orient": (("drop", "orient"), None),
    "orient,pair,close": (("orient", "pair", "close"), None),
    "orient,pair,debris": (("orient", "pair", "debris"), None),
    "cut by igl": (("cut",), "igl"),
    "drop by pymeshlab": (("drop",), "pymeshlab"),
}
# The tasks that are tried on what each strategy makes, if nothing else is said: those that take seconds.
TASKS = ("uv", "decimate_50", "subdivide", "boolean", "solid")


@dataclass(frozen=True)
class Look:
    """How a repaired asset looks on one tier, beside the original.

    `psnr` is the mean over the views in dB, as trials are judged (`msb.trial.renderings`), None where every pixel
    is the `same` or nothing is drawn; `why` then says why there is no picture.
    """

    psnr: float | None = None
    same: bool = False
    why: str | None = None


@dataclass(frozen=True, eq=False)
class Row:
    """What a strategy makes of the asset; `why` says that it failed, and then there is nothing else."""

    strategy: str
    plan: tuple[str, ...] = ()
    peer: Peer | None = None
    faces_kept: int = 0
    faces_added: int = 0
    edges_cut: int = 0
    before: Audit | None = None
    after: Audit | None = None
    looks: dict[Tier, Look] | None = None
    tried: tuple[Trial, ...] = ()
    tried_before: tuple[Trial, ...] = ()
    size: int = 0
    seconds: float = 0.0
    why: str | None = None
    picture: str | None = None

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
        counts, metrics = self.after.judged.counts, self.after.judged.metrics
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
            "trials": {one.task: one.outcome for one in self.tried},
            "trials_passed_before": passed(self.tried_before),
            "trials_passed_after": passed(self.tried),
            "bytes": self.size,
            "seconds": self.seconds,
            "picture": self.picture,
        }


def document(path: str | None, views: str, rows: Iterable[Row]) -> dict[str, Any]:
    """Return a comparison as JSON data; `views` says what it was looked at from, such as "8 test views"."""
    return {"schema": SCHEMA, "path": path, "views": views, "strategies": [row.to_dict() for row in rows]}


def passed(trials: Iterable[Trial]) -> int:
    """Return how many tasks work, with care or without."""
    return sum(one.outcome in ("works", "care") for one in trials)


def strategies(options: Options) -> dict[str, tuple[tuple[str, ...], Peer | None]]:
    """Return `STRATEGIES`, and the plan of `options` if it is none of them."""
    own = ",".join(options.plan)
    return STRATEGIES if own in STRATEGIES else {**STRATEGIES, own: (options.plan, None)}


def compare(
    asset: Asset,
    cameras: Views | Iterable[Camera],
    options: Options,
    *,
    tasks: Sequence[str] = TASKS,
    device: str | None = None,
    keep: Path | None = None,
    step: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Return a row for the asset as stored, and one for each strategy.

    Parameters
    ----------
    cameras : Views or iterable of Camera
        The views over which looks are compared, as far as they see the asset.
    options : Options
        Numbers of the steps, limits of the peers and of the libraries that try tasks, and one more plan.
    tasks : sequence of str
        Names of the tasks that are tried on the asset and on what each strategy makes.
    keep : Path, optional
        The folder that gets a picture of each strategy, from the first camera.
    step : callable
        Called after each row; there is one for each of `strategies`, and one more.
    """
    check_room({name: asset.buffers[name] for name in ("positions", "indices")})
    views = choose_views(asset, cameras).seeing(asset, device)
    judge = _Judge(views, tasks, options.limits, device)
    audit, _ = audit_stored(stored_mesh(asset))
    looks, before = judge.result(asset)
    stored = Row(
        STORED,
        faces_kept=asset.manifest.face_count,
        before=audit,
        after=audit,
        looks=looks,
        tried=before,
        tried_before=before,
        size=_size(asset),
    )
    step()
    rows = [stored]
    for name, (steps, peer) in strategies(options).items():
        start = time.perf_counter()
        try:
            done = repair_asset(asset, replace(options, plan=steps, peer=peer))
        except OutputError:  # of temporary files: no fault of the strategy
            raise
        except MsbError as error:
            rows.append(Row(name, steps, peer, why=f"{error.code}: {error.message}"))
            step()
            continue
        seconds = time.perf_counter() - start
        looks, tried = judge.result(done.asset)
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
                looks,
                tried,
                before,
                _size(done.asset),
                seconds,
                picture=None
                if keep is None or not views.cameras
                else _picture(keep, name, asset, done, views.cameras[0], device),
            )
        )
        step()
    return rows


class _Judge:
    """What strategies made, looked at and tried; what equals something earlier is not tried again."""

    def __init__(self, views: Views, tasks: Sequence[str], limits: Limits, device: str | None) -> None:
        self.views, self.tasks, self.limits, self.device = views, tasks, limits, device
        self.why = None if views.cameras else views.nothing
        self.originals: dict[Tier, Images | str] = {}
        """The images of the first asset that is judged."""
        self.known: dict[tuple[str, ...], tuple[dict[Tier, Look], tuple[Trial, ...]]] = {}

    def result(self, made: Asset) -> tuple[dict[Tier, Look], tuple[Trial, ...]]:
        """Return how an asset looks beside the first one, and what became of the tasks."""
        key = (made.manifest.method, *(spec.sha256 for spec in made.manifest.buffers.values()))
        if key not in self.known:
            drawn = {tier: self.why or _draw(made, tier, self.views.cameras, self.device) for tier in TIERS}
            self.originals = self.originals or drawn
            looks = {tier: _look(self.originals[tier], found) for tier, found in drawn.items()}
            self.known[key] = looks, self.tried(made)
        return self.known[key]

    def tried(self, made: Asset) -> tuple[Trial, ...]:
        """Return what became of the tasks."""
        if not self.tasks:
            return ()
        return try_asset(made, self.tasks, cameras=self.views, limits=self.limits, device=self.device).trials


def _draw(asset: Asset, tier: Tier, cameras: Sequence[Camera], device: str | None) -> Images | str:
    """Return the images of a tier, or why there are none."""
    why = why_not(asset.manifest, tier)
    if why is not None:
        return why
    try:
        with Renderer(asset, tier=tier, device=device, **lean_options(tier, None)) as renderer:
            return [to_bytes(renderer.render(camera, BACKGROUND).image) for camera in cameras]
    except MsbError as error:
        return f"{error.code}: {error.message}"


def _picture(
    keep: Path, name: str, asset: Asset, done: Repaired, camera: Camera, device: str | None
) -> str | None:
    """Return the file of the picture of a strategy; None where nothing draws it: the looks say why."""
    try:
        return keep_picture(keep, name, asset, done, camera, device)
    except OutputError:  # of the folder: no fault of what draws
        raise
    except MsbError:
        return None


def _look(original: Images | str, repaired: Images | str) -> Look:
    if isinstance(original, str) or isinstance(repaired, str):
        return Look(why=original if isinstance(original, str) else str(repaired))
    alike = likeness(original, repaired)
    return Look(same=True) if alike["same_pictures"] else Look(alike["psnr"])


def _size(asset: Asset) -> int:
    return sum(spec.byte_length for spec in asset.manifest.buffers.values())
