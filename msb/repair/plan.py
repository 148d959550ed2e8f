"""What a repair does: the steps of its plan, and the numbers of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from msb.asset.arguments import checked_number
from msb.base.limits import Limits
from msb.errors import UsageError, shorten
from msb.topology.weld import Weld, parse_weld

# The steps, in the order of docs/repair.md.
# orient: turn faces so that the winding is consistent.
# pair: at edges of more than two faces, join the flattest pairs and cut the rest.
# cut: cut edges of more than two faces, and vertices where surfaces only touch.
# drop: remove few faces until no edge has more than two.
# weld: merge coincident vertices.
# debris: remove small components.
# close: close small holes.
STEPS = ("orient", "pair", "cut", "drop", "weld", "debris", "close")
# The plan that changes nothing visible.
DEFAULT = ("orient", "pair")
Peer = Literal["igl", "pymeshlab"]
# Peer -> the steps that it can do in our stead.
BY_PEER: dict[str, tuple[str, ...]] = {"igl": ("cut",), "pymeshlab": ("drop",)}
# Step -> the options that may stand after it in a plan: ``debris:20:0.001``.
NUMBERS = {
    "pair": ("pair_color",),
    "weld": ("weld",),
    "debris": ("debris_faces", "debris_share"),
    "close": ("close_edges", "close_share"),
}
_WHOLE = ("debris_faces", "close_edges")


@dataclass(frozen=True)
class Options:
    """What a repair does, step by step; docs/repair.md explains each.

    Attributes
    ----------
    plan : tuple of str
        The steps in their order, repeated until none changes anything.
    weld : "exact" or float
        How `weld` merges vertices: equal float32 coordinates, or chains of vertices at most this far apart.
    pair_color : float
        What a difference of black and white counts to `pair`, beside a fold by 180 degrees, which counts 1.
    debris_faces : int
        `debris` removes components of fewer faces.
    debris_share : float
        `debris` also removes components that have a smaller share of the weight of all faces.
    close_edges : int
        `close` closes holes of at most so many edges.
    close_share : float
        `close` leaves rims open whose cap would have a larger share of the area of their component.
    peer : {"igl", "pymeshlab"}, optional
        The library that does `cut` (igl) or `drop` (pymeshlab) in our stead, in a child process.
    limits : Limits
        What that process may take.
    """

    plan: tuple[str, ...] = DEFAULT
    weld: Weld = "exact"
    pair_color: float = 0.25
    debris_faces: int = 10
    debris_share: float = 0.0
    close_edges: int = 8
    close_share: float = 0.25
    peer: Peer | None = None
    limits: Limits = field(default_factory=Limits)

    def check(self) -> Options:
        """Return these options if they can be used."""
        numbers = {
            name: checked_number(name, getattr(self, name), whole=name in _WHOLE)
            for name in ("pair_color", *_WHOLE, "debris_share", "close_share")
        }
        if self.peer is not None:
            can = BY_PEER.get(self.peer)
            if can is None:
                text = f'there is no peer "{shorten(str(self.peer), 40)}"; there are {", ".join(BY_PEER)}'
                raise UsageError("USAGE", text)
            if not set(can) & set(self.plan):
                text = f"{self.peer} can do {', '.join(can)}, and the plan is {','.join(self.plan)}"
                raise UsageError("USAGE", text)
        return replace(self, weld=parse_weld(self.weld), **numbers)  # type: ignore[arg-type]


def parse_plan(plan: Sequence[str] | str | None = None, **options: Any) -> Options:
    """Return the options of a plan: names of steps, in a text with commas between them.

    Numbers may stand after a step, as in "weld:0.01,orient,pair,debris:20:0.001". None is the default, or
    what the peer can do.
    """
    if plan is None:
        plan = BY_PEER.get(options.get("peer") or "", DEFAULT)
    steps = []
    given: dict[str, float | str] = {}
    for word in plan.split(",") if isinstance(plan, str) else plan:
        step, *numbers = str(word).split(":")
        if step not in STEPS:
            text = f'there is no step "{shorten(step, 40)}"; there are {", ".join(STEPS)}'
            raise UsageError("USAGE", text)
        known = NUMBERS.get(step, ())
        if len(numbers) > len(known):
            takes = ":".join((step, *(name.upper() for name in known)))
            raise UsageError("USAGE", f'"{shorten(str(word), 40)}" has too many numbers; it may be {takes}')
        values = {name: _number(name, text) for name, text in zip(known, numbers, strict=False)}
        if any(given.get(name, value) != value for name, value in values.items()):
            text = f'"{shorten(str(word), 40)}" has other numbers than {step} before; a plan has one of each'
            raise UsageError("USAGE", text)
        given |= values
        steps.append(step)
    if not steps:
        raise UsageError("USAGE", f"the plan has no step; there are {', '.join(STEPS)}")
    return Options(tuple(steps), **(options | given)).check()


def _number(name: str, text: str) -> float | str:
    if name == "weld":
        return text
    try:
        return int(text) if name in _WHOLE else float(text)
    except ValueError:
        wanted = "a whole number" if name in _WHOLE else "a number"
        text = f'{name} of the plan is "{shorten(text, 40)}"; it must be {wanted}'
        raise UsageError("USAGE", text) from None
