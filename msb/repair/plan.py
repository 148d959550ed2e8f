"""What a plan of repairs may name, and the numbers of its steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msb.asset.arguments import check_type, checked_number
from msb.errors import UsageError, shorten
from msb.topology.weld import parse_weld

if TYPE_CHECKING:
    from msb.topology.weld import Weld

STEPS: dict[str, str] = {
    "orient": "turn faces so that the winding is consistent",
    "pair": "at edges of more than two faces join the flattest pairs, and cut the rest",
    "cut": "cut edges of more than two faces, and vertices where surfaces only touch",
    "drop": "remove few faces until no edge has more than two",
    "weld": "merge vertices in one place",
    "debris": "remove small components",
    "close": "close small holes",
}
"""Step -> what it does, in the order of docs/repair.md."""
DEFAULT = ("orient", "pair")
"""The plan that changes nothing visible."""
BY_PEER = {"igl": ("cut",), "pymeshlab": ("drop",)}
"""Peer -> the steps that it can do in our stead."""
_WHOLE = ("debris_faces", "close_edges")
_LIMITS = ("seconds", "memory_gib")


@dataclass(frozen=True)
class Options:
    """The numbers of the steps; docs/repair.md explains each."""

    weld: Weld = "exact"
    pair_color: float = 0.25
    debris_faces: int = 10
    debris_share: float = 0.0
    close_edges: int = 8
    close_share: float = 0.25
    peer: str | None = None
    seconds: float = 60.0
    memory_gib: float = 4.0

    def check(self) -> Options:
        """Return these options if they can be used."""
        numbers = {
            name: checked_number(name, getattr(self, name), whole=name in _WHOLE, positive=name in _LIMITS)
            for name in ("pair_color", *_WHOLE, "debris_share", "close_share", *_LIMITS)
        }
        if self.peer is not None and self.peer not in tuple(BY_PEER):
            text = f'there is no peer "{shorten(str(self.peer), 40)}"; there are {", ".join(BY_PEER)}'
            raise UsageError("USAGE", text)
        return replace(self, weld=parse_weld(self.weld), **numbers)  # type: ignore[arg-type]


def parse_plan(plan: Sequence[str] | str) -> tuple[str, ...]:
    """Return the steps that a plan names."""
    check_type("plan", plan, Iterable, "names of steps")
    names = tuple(plan.split(",")) if isinstance(plan, str) else tuple(plan)
    for name in names:
        if name not in tuple(STEPS):
            text = f'there is no step "{shorten(str(name), 40)}"; there are {", ".join(STEPS)}'
            raise UsageError("USAGE", text)
    if not names:
        raise UsageError("USAGE", f"the plan has no step; there are {', '.join(STEPS)}")
    return names


def check_peer(plan: Sequence[str], peer: str | None) -> None:
    """Refuse a peer that has none of the plan's steps."""
    if peer is not None and not set(plan) & set(BY_PEER[peer]):
        text = f"{peer} can do {', '.join(BY_PEER[peer])}, and the plan is {','.join(plan)}"
        raise UsageError("USAGE", text)
