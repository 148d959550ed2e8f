"""Compare repair plans by the faces that they keep, the loss of image quality, and the tasks that work."""

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
from msb.errors import MsbError, OutputError
from msb.render import Renderer
from msb.render.backend import minimal_options
from msb.render.images import to_bytes
from msb.repair.assets import repair_asset
from msb.repair.pictures import save_picture
from msb.topology.halfedge import NONE
from msb.trial.renderings import BACKGROUND, compare_images
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
    from msb.views import ChosenViews

    Images = list[NDArray[np.uint8]]

SCHEMA = "msb.repair_compare/1"
TIERS: tuple[Tier, ...] = ("standard", "dedicated")
# The name of the table row for the mesh without a repair.
STORED = "as stored"
# Maps the name of a strategy to its repair plan and to the library that runs the repair step. None means
# MeshSplatBench.
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
# The tasks that are tried on every result by default. These tasks take only seconds.
TASKS = ("uv", "decimate_50", "subdivide", "boolean", "solid")


@dataclass(frozen=True)
class TierLikeness:
    """The similarity between renderings of a repaired asset and renderings of the original, on one renderer
    tier.

    The field `psnr` is the average over the views in dB. The value is None if all images are equal (`same`).
    The value is also None if the tier cannot be rendered, for the reason `why`.
    """

    psnr: float | None = None
    same: bool = False
    why: str | None = None


@dataclass(frozen=True, eq=False)
class StrategyResult:
    """The result of a repair strategy. If the strategy failed, only the reason `why` is set."""

    strategy: str
    plan: tuple[str, ...] = ()
    peer: Peer | None = None
    faces_kept: int = 0
    faces_added: int = 0
    edges_cut: int = 0
    before: Audit | None = None
    after: Audit | None = None
    looks: dict[Tier, TierLikeness] | None = None
    trials: tuple[Trial, ...] = ()
    trials_before: tuple[Trial, ...] = ()
    size: int = 0
    seconds: float = 0.0
    why: str | None = None
    picture: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the result of the strategy as JSON data."""
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
            "trials": {trial.task: trial.outcome for trial in self.trials},
            "trials_passed_before": count_passed(self.trials_before),
            "trials_passed_after": count_passed(self.trials),
            "bytes": self.size,
            "seconds": self.seconds,
            "picture": self.picture,
        }


def document(path: str | None, views: str, rows: Iterable[StrategyResult]) -> dict[str, Any]:
    """Return a comparison of repairs as JSON data.

    The argument `views` describes the views, such as "8 test views".
    """
    return {"schema": SCHEMA, "path": path, "views": views, "strategies": [row.to_dict() for row in rows]}


def count_passed(trials: Iterable[Trial]) -> int:
    """Return the number of tasks with the outcome "works" or "works with limitations"."""
    return sum(trial.outcome in ("works", "care") for trial in trials)


def list_strategies(options: Options) -> dict[str, tuple[tuple[str, ...], Peer | None]]:
    """Return `STRATEGIES`, and the plan of `options` if `STRATEGIES` does not contain this plan."""
    name = ",".join(options.plan)
    return STRATEGIES if name in STRATEGIES else {**STRATEGIES, name: (options.plan, None)}


def compare(
    asset: Asset,
    cameras: ChosenViews | Iterable[Camera],
    options: Options,
    *,
    tasks: Sequence[str] = TASKS,
    device: str | None = None,
    keep: Path | None = None,
    step: Callable[[], None] = lambda: None,
) -> list[StrategyResult]:
    """Return a result for the asset as stored, and a result for each repair strategy.

    Parameters
    ----------
    cameras : ChosenViews or iterable of Camera
        The views for comparing renderings. Views that do not see the asset are ignored.
    options : Options
        Options of the repair steps, limits of child processes, and one additional plan.
    tasks : sequence of str
        Names of the tasks to try on the asset and on every result.
    keep : Path, optional
        A folder for an image of each result, from the first camera.
    step : callable
        Called after each row: once for the asset as stored, and once per strategy.
    """
    check_room({name: asset.buffers[name] for name in ("positions", "indices")})
    views = choose_views(asset, cameras).without_blind(asset, device)
    evaluator = _Evaluator(views, tasks, options.limits, device)
    # First evaluate the asset as stored.
    audit, _ = audit_stored(stored_mesh(asset))
    looks, before = evaluator.evaluate(asset)
    stored = StrategyResult(
        STORED,
        faces_kept=asset.manifest.face_count,
        before=audit,
        after=audit,
        looks=looks,
        trials=before,
        trials_before=before,
        size=_sum_bytes(asset),
    )
    step()
    # The strategies. A failed strategy gets a row with the reason of the failure.
    rows = [stored]
    for name, (steps, peer) in list_strategies(options).items():
        start = time.perf_counter()
        try:
            done = repair_asset(asset, replace(options, plan=steps, peer=peer))
        except OutputError:  # Temporary files cannot be written.
            raise
        except MsbError as error:
            rows.append(StrategyResult(name, steps, peer, why=f"{error.code}: {error.message}"))
            step()
            continue
        seconds = time.perf_counter() - start
        looks, trials = evaluator.evaluate(done.asset)
        kept = int((done.face_map != NONE).sum())
        rows.append(
            StrategyResult(
                name,
                steps,
                peer,
                kept,
                len(done.face_map) - kept,
                len(done.cut_edges),
                done.before,
                done.after,
                looks,
                trials,
                before,
                _sum_bytes(done.asset),
                seconds,
                picture=None
                if keep is None or not views.cameras
                else _save_picture(keep, name, asset, done, views.cameras[0], device),
            )
        )
        step()
    return rows


class _Evaluator:
    """Renders the results of repairs, and tries tasks on them.

    A result that equals an earlier result is not evaluated again.
    """

    def __init__(self, views: ChosenViews, tasks: Sequence[str], limits: Limits, device: str | None) -> None:
        self.views, self.tasks, self.limits, self.device = views, tasks, limits, device
        self.why = views.why_not
        # The images of the first asset, by renderer tier. The images of all other assets are compared with
        # the images of the first asset.
        self.originals: dict[Tier, Images | str] = {}
        self.known: dict[tuple[str, ...], tuple[dict[Tier, TierLikeness], tuple[Trial, ...]]] = {}

    def evaluate(self, asset: Asset) -> tuple[dict[Tier, TierLikeness], tuple[Trial, ...]]:
        """Return the similarity of an asset to the first asset on each tier, and the results of the tasks."""
        key = (asset.manifest.method, *(spec.sha256 for spec in asset.manifest.buffers.values()))
        if key not in self.known:
            images = {
                tier: self.why or _render(asset, tier, self.views.cameras, self.device) for tier in TIERS
            }
            self.originals = self.originals or images
            looks = {tier: _compare_tier(self.originals[tier], result) for tier, result in images.items()}
            self.known[key] = looks, self.try_tasks(asset)
        return self.known[key]

    def try_tasks(self, asset: Asset) -> tuple[Trial, ...]:
        """Return the results of the tasks on `asset`."""
        if not self.tasks:
            return ()
        return try_asset(asset, self.tasks, cameras=self.views, limits=self.limits, device=self.device).trials


def _render(asset: Asset, tier: Tier, cameras: Sequence[Camera], device: str | None) -> Images | str:
    """Return the images on a renderer tier, or the reason why the tier cannot be rendered."""
    why = why_not(asset.manifest, tier)
    if why is not None:
        return why
    try:
        with Renderer(asset, tier=tier, device=device, **minimal_options(tier, None)) as renderer:
            return [to_bytes(renderer.render(camera, BACKGROUND).image) for camera in cameras]
    except MsbError as error:
        return f"{error.code}: {error.message}"


def _save_picture(
    keep: Path, name: str, asset: Asset, done: Repaired, camera: Camera, device: str | None
) -> str | None:
    """Write the image of a result and return its file name. Return None if the result cannot be rendered."""
    try:
        return save_picture(keep, name, asset, done, camera, device)
    except OutputError:  # the folder cannot be written
        raise
    except MsbError:  # The field `TierLikeness.why` gives the reason.
        return None


def _compare_tier(original: Images | str, repaired: Images | str) -> TierLikeness:
    """Compare the images of two assets on a tier.

    If images are missing, the argument is a text with the reason.
    """
    if isinstance(original, str) or isinstance(repaired, str):
        return TierLikeness(why=original if isinstance(original, str) else str(repaired))
    result = compare_images(original, repaired)
    return TierLikeness(same=True) if result["same_pictures"] else TierLikeness(result["psnr"])


def _sum_bytes(asset: Asset) -> int:
    """Return the total size of all buffers in bytes."""
    return sum(spec.byte_length for spec in asset.manifest.buffers.values())
