"""All causes at once: what a plain mesh loses, what engine settings mend, and what only a bake could."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from msb.views import difference
from msb.why.causes import BAKED, lit, taken_for_linear
from msb.why.views import EQUAL, DoesNotApplyError, Views

TITLE = "All of it at once (standard tier against its own look)"
# dB above which a cause is not seen, so that it is no reason for what is left.
_SEEN = 40.0


@dataclass(frozen=True)
class Total:
    """What a plain mesh loses against the method's own look, in dB over all views; None where it has none.

    Attributes
    ----------
    db : float or None
        The standard tier, as `msb render` draws it.
    reason : str or None
        Why there is no such number.
    wrong, right : float or None
        The same with every engine setting wrong (lit, colours taken for linear, back faces culled), and with
        every one right (unlit, colours as they are, two-sided, as many samples as the method takes).
    baked : float or None
        The method's own look without all that an opaque mesh cannot have, which is what only a bake mends.
    bakes : tuple of str
        The names of these causes that are seen, the gravest first.
    """

    db: float | None
    reason: str | None = None
    wrong: float | None = None
    right: float | None = None
    baked: float | None = None
    bakes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return what `msb why --json` writes; a number is null where images are equal."""
        return {
            "db": _finite(self.db),
            "equal": self.db is not None and self.db >= EQUAL,
            "reason": self.reason,
            "engine_settings": {"wrong_db": _finite(self.wrong), "right_db": _finite(self.right)},
            "bake": {"db": _finite(self.baked), "causes": list(self.bakes)},
        }


def _finite(db: float | None) -> float | None:
    return None if db is None or db >= EQUAL else db


def measured_total(views: Views, costs: Mapping[str, float | None]) -> Total:
    """Return the total; `costs` are the decibels of each cause by itself."""
    try:
        own, plain = views.official, views.plain.frames
    except DoesNotApplyError as error:
        return Total(None, str(error))
    db = difference(plain, own)
    wrong = difference(taken_for_linear(lit(views.plain.culled, views.light)), own)
    right = difference(views.plain.supersampled, own)
    asset = views.asset
    settings: dict[str, Any] = {}
    for change in BAKED.values():
        with contextlib.suppress(DoesNotApplyError):
            asset, own_settings = change(asset)
            settings |= own_settings
    baked = difference(views.own(asset, settings=settings), own)
    seen = [(cost, name) for name in BAKED if (cost := costs[name]) is not None and cost < _SEEN]
    return Total(db, None, wrong, right, baked, tuple(name for _, name in sorted(seen)))
