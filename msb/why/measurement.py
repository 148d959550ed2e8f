"""Measure the causes of a loss of image quality on an asset.

Each cause is measured alone, then all causes are measured together.
"""

from __future__ import annotations

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
from msb.scenes.datasets import default_background
from msb.views import ChosenViews, choose_views, pooled_psnr, squared_errors
from msb.why.causes import CAUSES, CauseDefinition
from msb.why.total import Total, measure_total
from msb.why.views import EQUAL, CauseViews, DoesNotApplyError, Image, clip_image


@dataclass(frozen=True)
class Cause:
    """One cause that can make an export look worse than the native rendering.

    Attributes
    ----------
    name : str
        The name in code and JSON, such as "view_dependence".
    title : str
        The name in reports, such as "Colours independent of the view".
    applies : bool
        Whether the asset can be drawn both with and without the cause.
    db : float or None
        PSNR in dB between the images with and without the cause, over all views. The PSNR is inf for equal
        images, and None if the cause does not apply.
    reason : str or None
        The reason why the cause does not apply. If the cause applies, the value is None.
    how_to_see : str
        How to recognise the cause in a program.
    remedy : str
        How to avoid the cause.
    without, with_it : (H, W, 3) float32 or None
        The images without and with the cause, in the view with the largest difference.
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
        """Return the record for `msb why --json`. For equal images, `db` is null and `equal` is true."""
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
    """A list of causes with the loss of each cause.

    `total` contains the loss of the standard-tier mesh. `views` contains the cameras that see the asset.
    """

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
    """Return the loss of each cause that makes an export of this asset look worse than the native rendering.

    Parameters
    ----------
    asset : Asset or path-like
        An asset, or the path of anything that `msb.open` accepts.
    cameras : iterable of Camera, optional
        At least one camera. Default: training cameras beside the path, or else eight cameras around or inside
        the asset.
    background : (3,) floats, or str, optional
        The background, with the values and the default of `msb.render`.
    settings : mapping, optional
        Settings of all renderings. The given values replace the settings stored in the asset.
    device : str, optional
        The OpenCL device.
    step : callable
        Callback that is called after each cause, and after the total.

    Returns
    -------
    list of Cause
        One entry for each of `CAUSES`, including causes that do not apply. If no camera sees the asset, no
        cause applies. The list's attribute `total` contains the loss of the standard-tier mesh. The attribute
        `views` contains the `cameras` that see the asset.

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
    color = default_background(model.manifest) if background is None else check_background(background, stated)
    views = CauseViews(model, chosen, color, device)
    causes = Causes()
    causes.views = views.chosen
    with few_frames():
        for definition in CAUSES:
            causes.append(_measure_cause(definition, views))
            step()
        causes.total = measure_total(views, {cause.name: cause.db for cause in causes})
    step()
    return causes


def _measure_cause(definition: CauseDefinition, views: CauseViews) -> Cause:
    """Return the loss of one cause."""
    texts = (definition.how_to_see, definition.remedy)
    try:
        with_it, without = definition.draw(views)
    except DoesNotApplyError as error:
        return Cause(definition.name, definition.title, False, None, str(error), *texts)
    # An array (views, 2): the sum of squared errors and the number of values of each view.
    errors = squared_errors(with_it, without)
    worst = int(np.argmax(errors[:, 0] / errors[:, 1]))
    return Cause(
        definition.name,
        definition.title,
        True,
        pooled_psnr(errors),
        None,
        *texts,
        clip_image(without[worst]),
        clip_image(with_it[worst]),
    )
