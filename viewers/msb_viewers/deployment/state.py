"""The state of a comparison: its layout, and the two tiers of the layouts wipe and difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from msb.errors import UsageError, shorten
from msb_viewers.deployment.arrange import Cell, arrange
from msb_viewers.deployment.shots import BAKED, REFERENCE, TRUTH, Comparison
from msb_viewers.sheet import text_scale

Layout = Literal["side", "wipe", "difference"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)


@dataclass(frozen=True, eq=False)
class CompareState:
    """The layout of a comparison.

    `pair` has the tiers A and B that wipe and difference compare. The PSNR of each tier compares the tier
    with the tier A. If only one tier has an image, A and B are both this tier.
    """

    comparison: Comparison
    pair: tuple[str, str]
    layout: Layout = "side"

    @classmethod
    def first(
        cls,
        comparison: Comparison,
        *,
        layout: Layout = "side",
        pair: str | None = None,
    ) -> CompareState:
        """Return the first state of a comparison; `pair` is a text such as "reference,standard"."""
        chosen = _default_pair(comparison) if pair is None else _parse_pair(comparison, pair)
        if layout != "side" and chosen[0] == chosen[1]:
            text = f"--layout {layout} needs two tiers, but only {chosen[0]} has an image"
            raise UsageError("NAME_UNKNOWN", text)
        return cls(comparison, chosen, layout)

    @property
    def aspect(self) -> float:
        """Width divided by height of the images of the first view."""
        camera = self.comparison.views[0].camera
        return camera.width / camera.height

    def cells(self, size: tuple[int, int]) -> list[Cell]:
        """Return the positions of the panels in an image of `size` pixels."""
        tiers = self.comparison.tiers
        return arrange(self.layout, tiers, self.pair, size, text_scale(size), aspect=self.aspect)

    def wanted_tiers(self) -> tuple[str, ...]:
        """Return the renderer tiers that the layout shows."""
        if self.layout == "side":
            return self.comparison.tiers
        return tuple(tier for tier in self.comparison.tiers if tier in self.pair)


def _default_pair(comparison: Comparison) -> tuple[str, str]:
    """Return the default tiers A and B.

    A shows photographs or the native rendering, and B shows the baked mesh or the standard tier.
    """
    tiers = comparison.drawable
    first = next(tier for tier in (TRUTH, "dedicated", REFERENCE, "standard", BAKED) if tier in tiers)
    rest = [tier for tier in (BAKED, "standard", "dedicated", REFERENCE) if tier in tiers and tier != first]
    return first, rest[0] if rest else first


def _parse_pair(comparison: Comparison, text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    known = comparison.drawable
    if len(names) != 2 or names[0] == names[1]:
        problem = f'--pair is "{shorten(text, 40)}"; it must be two tiers, such as dedicated,standard'
        raise UsageError("NAME_UNKNOWN", problem)
    for name in names:
        if name not in known:
            why = comparison.missing.get(name)
            problem = f'--pair: the tier "{shorten(name, 40)}" has no image' + (f": {why}" if why else "")
            raise UsageError("NAME_UNKNOWN", f"{problem}; use two of {', '.join(known)}")
    return names[0], names[1]
