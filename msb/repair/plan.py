"""The plan of a repair: its steps and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from msb.asset.arguments import checked_number
from msb.base.limits import Limits
from msb.errors import UsageError, shorten
from msb.repair.options import STEPS
from msb.topology.weld import Weld, parse_weld

# The default plan. The default plan does not change the appearance of a model.
DEFAULT = ("orient", "pair")
Peer = Literal["igl", "pymeshlab"]
# Maps a library to the steps that it can run in place of MeshSplatBench.
BY_PEER: dict[str, tuple[str, ...]] = {"igl": ("cut",), "pymeshlab": ("drop",)}
# Maps a step to the options that may follow it as numbers, as in ``debris:20:0.001``.
NUMBERS = {
    "pair": ("pair_color",),
    "weld": ("weld",),
    "debris": ("debris_faces", "debris_share"),
    "close": ("close_edges", "close_share"),
}
# Options that must be whole numbers.
_WHOLE = ("debris_faces", "close_edges")


@dataclass(frozen=True)
class Options:
    """The options of a repair. The page docs/repair.md explains the steps.

    Attributes
    ----------
    plan : tuple of str
        The steps in order. The steps are repeated until nothing changes.
    weld : "exact" or float
        The step `weld` merges vertices with equal float32 coordinates ("exact"), or chains of vertices with
        at most this distance.
    pair_color : float
        The weight of colour differences for `pair`: the cost of joining a black and a white face. A fold by
        180 degrees has the cost 1.
    debris_faces : int
        The step `debris` removes components with fewer faces than this.
    debris_share : float
        The step `debris` also removes components with less than this share of the total face weight.
    close_edges : int
        The step `close` fills holes with at most this number of edges.
    close_share : float
        The step `close` leaves a hole open if the new faces would cover more than this share of the
        component's area.
    peer : {"igl", "pymeshlab"}, optional
        The library that runs `cut` (igl) or `drop` (pymeshlab) in a child process. None means that
        MeshSplatBench runs all steps.
    limits : Limits
        Time and memory limits of the child process.
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

    def covers(self, other: Options) -> bool:
        """Return whether this plan has all steps of `other`, and at least its weld distance and its
        `close_share`.
        """
        ours, theirs = (0.0 if plan.weld == "exact" else float(plan.weld) for plan in (self, other))
        return (
            set(other.plan) <= set(self.plan)
            and ("weld" not in other.plan or ours >= theirs)
            and ("close" not in other.plan or self.close_share >= other.close_share)
        )

    def check(self) -> Options:
        """Return the options after validation. Raise USAGE or WELD_DISTANCE if the options are invalid."""
        numbers = {
            name: checked_number(name, getattr(self, name), whole=name in _WHOLE)
            for name in ("pair_color", *_WHOLE, "debris_share", "close_share")
        }
        if self.peer is not None:
            supported = BY_PEER.get(self.peer)
            if supported is None:
                text = f'unknown library "{shorten(str(self.peer), 40)}"; use {" or ".join(BY_PEER)}'
                raise UsageError("USAGE", text)
            if not set(supported) & set(self.plan):
                text = f"{self.peer} can only do {', '.join(supported)}, which is not in the plan "
                raise UsageError("USAGE", text + ",".join(self.plan))
        return replace(self, weld=parse_weld(self.weld), **numbers)  # type: ignore[arg-type]


def parse_plan(plan: Sequence[str] | str | None = None, **options: Any) -> Options:
    """Return the validated options of a plan, given as a sequence of steps or as text with commas.

    A step may have numbers, as in "weld:0.01,orient,pair,debris:20:0.001". The default is the default plan,
    or the step of the library in `options`. The argument `options` contains other fields of `Options`.
    """
    if plan is None:
        plan = BY_PEER.get(options.get("peer") or "", DEFAULT)
    steps = []
    given: dict[str, float | str] = {}
    for word in plan.split(",") if isinstance(plan, str) else plan:
        step, *numbers = str(word).split(":")
        if step not in STEPS:
            text = f'unknown step "{shorten(step, 40)}"; use one of {", ".join(STEPS)}'
            raise UsageError("USAGE", text)
        known = NUMBERS.get(step, ())
        if len(numbers) > len(known):
            takes = ":".join((step, *(name.upper() for name in known)))
            raise UsageError("USAGE", f'"{shorten(str(word), 40)}" has too many numbers; use {takes}')
        values = {name: _parse_number(name, text) for name, text in zip(known, numbers, strict=False)}
        if any(given.get(name, value) != value for name, value in values.items()):
            text = f'"{shorten(str(word), 40)}" contradicts the numbers of an earlier {step}'
            raise UsageError("USAGE", text)
        given |= values
        steps.append(step)
    if not steps:
        raise UsageError("USAGE", f"the plan is empty; use one or more of {', '.join(STEPS)}")
    return Options(tuple(steps), **(options | given)).check()


def _parse_number(name: str, text: str) -> float | str:
    """Return the value of the option `name` in a plan as a number. Only the step weld accepts a text."""
    if name == "weld":
        return text
    try:
        return int(text) if name in _WHOLE else float(text)
    except ValueError:
        kind = "a whole number" if name in _WHOLE else "a number"
        text = f'{name} in the plan is "{shorten(text, 40)}"; it must be {kind}'
        raise UsageError("USAGE", text) from None
