"""Measure every cause of a worse look on one asset, and all of them together."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.arguments import check_type
from msb.asset.settings import with_settings
from msb.render.splat.order import few_frames
from msb.scenes import Camera
from msb.scenes.colors import check_background
from msb.scenes.datasets import own_background
from msb.views import Views as ChosenViews
from msb.views import choose_views, pooled_psnr, squared_errors
from msb.why.causes import CAUSES, Known
from msb.why.total import Total, measured_total
from msb.why.views import EQUAL, DoesNotApplyError, Image, Views, clipped


@dataclass(frozen=True)
class Cause:
    """One way in which an export can look worse than the render.

    Attributes
    ----------
    name : str
        Such as "view_dependence".
    title : str
        The same in words.
    applies : bool
        Whether this asset can be drawn with it and without it.
    db : float or None
        PSNR in dB over all views of the images with it to those without; inf if they are equal, None if it
        does not apply.
    reason : str or None
        Why it does not apply.
    how_to_see : str
        How to find out whether it is the cause of what one sees.
    remedy : str
        What to do then.
    without, with_it : (H, W, 3) float32 or None
        The view in which it is seen best.
    """

    name: str
    title: str
    applies: bool
    db: float | None
    reason: str | None
    how_to_see: str
    remedy: str
    without: Image | None = None
    with_it: Image | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return what `msb why --json` writes; `db` is null if the images are equal, and `equal` says so."""
        equal = self.db is not None and self.db >= EQUAL
        return {
            "name": self.name,
            "title": self.title,
            "applies": self.applies,
            "db": None if equal else self.db,
            "equal": equal,
            "reason": self.reason,
            "how_to_see": self.how_to_see,
            "remedy": self.remedy,
        }


class Causes(list[Cause]):
    """What each cause costs, as `total` what all of them do at once, and the views that saw it."""

    total: Total
    views: ChosenViews


def why(
    asset: Asset | str | os.PathLike[str],
    cameras: ChosenViews | Iterable[Camera] | None = None,
    *,
    background: Sequence[float] | str | None = None,
    settings: Mapping[str, Any] | None = None,
    device: str | None = None,
    step: Callable[[], None] = lambda: None,
) -> Causes:
    """Return what each cause of a worse look costs this asset.

    Parameters
    ----------
    asset : Asset or path-like
        An asset, or the path of anything that `msb.open` takes.
    cameras : sequence of Camera, optional
        The views, at least one; those of its training where they lie beside the path, else eight views round
        it, or inside it, if not given.
    background : (3,) floats, or str, optional
        As for `msb.render`, with its default.
    settings : mapping, optional
        Values that replace settings that the asset stores, in all that is drawn.
    device : str, optional
        The OpenCL device.
    step : callable
        Called after each cause, and after the total.

    Returns
    -------
    list of Cause
        One for each of `CAUSES`, also for those that do not apply: none does where no view sees the asset.
        Its attribute `total` is all at once, and `views` has the `cameras` that see the asset.

    Raises
    ------
    UsageError, AssetError, DeviceError
        The errors of `msb.Renderer`.
    """
    if settings is not None:
        check_type("settings", settings, Mapping, "a mapping from names to values")
    model = with_settings(as_asset(asset), settings or {})
    chosen = choose_views(model, cameras, device=device)
    stated = model.manifest.appearance.get("background")
    color = own_background(model.manifest) if background is None else check_background(background, stated)
    views = Views(model, chosen, color, device)
    causes = Causes()
    causes.views = views.chosen
    with few_frames():
        for known in CAUSES:
            causes.append(_measured(known, views))
            step()
        causes.total = measured_total(views, {cause.name: cause.db for cause in causes})
    step()
    return causes


def _measured(known: Known, views: Views) -> Cause:
    texts = (known.how_to_see, known.remedy)
    try:
        with_it, without = known.measure(views)
    except DoesNotApplyError as error:
        return Cause(known.name, known.title, False, None, str(error), *texts)
    errors = squared_errors(with_it, without)
    worst = int(np.argmax(errors[:, 0] / errors[:, 1]))
    return Cause(
        known.name,
        known.title,
        True,
        pooled_psnr(errors),
        None,
        *texts,
        clipped(without[worst]),
        clipped(with_it[worst]),
    )
