"""What a finding is, and what findings of every kind say alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from msb.bench.intervals import excludes_zero
from msb.report.numbers import dataset_title, method_title

if TYPE_CHECKING:
    from msb.bench.intervals import Interval


@dataclass(frozen=True)
class Finding:
    """One sentence. `table` labels the table of its numbers; `kind` says what it is about."""

    kind: str
    sentence: str
    table: str

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data."""
        return {"kind": self.kind, "sentence": self.sentence, "table": self.table}


class Case(NamedTuple):
    """A number of a method on a dataset, and how it is told; cases are in the order of their numbers."""

    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        """The method and the dataset, as titles."""
        return f"{method_title(self.method)} on {dataset_title(self.dataset)}"


def sure(found: Interval | None) -> str:
    """Return what is said of a difference's significance, or why nothing is; nothing of bare numbers."""
    if found is None:
        return ""
    if found.p is None:
        return f", not tested: {found.reason}"
    return f", {'' if excludes_zero(found) else 'not '}significant at 95 % (t interval over {found.over})"
