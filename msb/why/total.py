"""The loss of the standard-tier mesh, and the parts that settings or a bake can avoid."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from msb.views import psnr_over_views
from msb.why.causes import BAKED, apply_light, interpret_as_linear
from msb.why.views import EQUAL, CauseViews, DoesNotApplyError

TITLE = "Standard-tier mesh with every engine setting right (unlit, two-sided, colours unchanged)"
# If the PSNR of a cause in dB is higher, the cause is invisible and does not explain the remaining loss.
_VISIBLE = 40.0


@dataclass(frozen=True)
class Total:
    """The PSNR of a standard-tier mesh against the native rendering, in dB over all views.

    All numbers are None if the asset has no standard-tier mesh or no native rendering.

    Attributes
    ----------
    db : float or None
        The mesh rendered by `msb render`.
    reason : str or None
        The reason why the numbers are missing.
    wrong : float or None
        The mesh with every engine setting wrong: lit, colours interpreted as linear, back faces culled.
    right : float or None
        The mesh with every engine setting right: unlit, colours unchanged, two-sided, and as many samples per
        pixel as the native renderer.
    baked : float or None
        The native rendering of the model without view-dependent colours, transparency and soft edges, which
        no opaque mesh can show. Only a bake can avoid this loss.
    bakes : tuple of str
        Names of the visible causes of the loss `baked`. The cause with the largest loss comes first.
    """

    db: float | None
    reason: str | None = None
    wrong: float | None = None
    right: float | None = None
    baked: float | None = None
    bakes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the record for `msb why --json`. If the images are equal, the PSNR is null."""
        return {
            "db": _finite(self.db),
            "equal": self.db is not None and self.db >= EQUAL,
            "reason": self.reason,
            "engine_settings": {"wrong_db": _finite(self.wrong), "right_db": _finite(self.right)},
            "bake": {"db": _finite(self.baked), "causes": list(self.bakes)},
        }


def _finite(db: float | None) -> float | None:
    return None if db is None or db >= EQUAL else db


def measure_total(views: CauseViews, losses: Mapping[str, float | None]) -> Total:
    """Return the loss of the standard-tier mesh. `losses` contains the PSNR in dB for each single cause."""
    try:
        native, standard = views.native, views.standard
    except DoesNotApplyError as error:
        return Total(None, str(error))
    db = psnr_over_views(standard.frames, native)
    wrong = psnr_over_views(interpret_as_linear(apply_light(standard.culled, views.light)), native)
    right = psnr_over_views(standard.supersampled, native)
    # Remove all properties from the model that an opaque mesh cannot show.
    asset = views.asset
    settings: dict[str, Any] = {}
    for change in BAKED.values():
        with contextlib.suppress(DoesNotApplyError):
            asset, changed = change(asset)
            settings |= changed
    baked = psnr_over_views(views.draw_native(asset, settings=settings), native)
    visible = [(loss, name) for name in BAKED if (loss := losses[name]) is not None and loss < _VISIBLE]
    return Total(db, None, wrong, right, baked, tuple(name for _, name in sorted(visible)))
