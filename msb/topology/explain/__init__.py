"""The definition of every number of the audit, as plain data: what `msb-audit --explain` prints.

docs/definitions.md holds the reasoning behind it, and on the site the same data.
"""

from __future__ import annotations

from collections.abc import Iterator

from msb.errors import UsageError, shorten
from msb.topology.explain.counts import COUNTS
from msb.topology.explain.entry import Explanation
from msb.topology.explain.metrics import METRICS
from msb.topology.explain.others import OTHERS

__all__ = ["EXPLANATIONS", "Explanation", "explain"]

EXPLANATIONS: dict[str, Explanation] = {e.name: e for e in (*METRICS, *COUNTS, *OTHERS)}
"""Name in the JSON -> explanation; the paper's columns first."""


def explain(name: str) -> Explanation:
    """Return what a quantity means.

    Parameters
    ----------
    name : str
        Its key in the JSON (`nonmanifold_edge_ratio`), with or without the object it is in
        (`metrics.nonmanifold_edge_ratio`), or its symbol in formulas (`nm_edge_ratio`, `E_gt2`); upper and
        lower case and "-" for "_" do not matter.

    Examples
    --------
    >>> explain("metrics.vf-ratio").formula
    'V / F'
    """
    import difflib

    wanted = name.strip().replace("-", "_").removeprefix("welded.")
    wanted = wanted.removeprefix("counts.").removeprefix("metrics.")
    exact = dict(_names())
    # LCC_area and lcc_area are two symbols: without the right case it is the first one, the paper's column.
    folded: dict[str, Explanation] = {}
    for known, entry in exact.items():
        folded.setdefault(known.casefold(), entry)
    found = exact.get(wanted) or folded.get(wanted.casefold())
    if found is None:
        near = difflib.get_close_matches(wanted.casefold(), folded, 3, 0.5)
        hint = f"did you mean {' or '.join(near)}" if near else f"the names are {', '.join(EXPLANATIONS)}"
        raise UsageError("NAME_UNKNOWN", f'there is no quantity "{shorten(name)}"; {hint}')
    return found


def _names() -> Iterator[tuple[str, Explanation]]:
    """Yield every name a user may ask by."""
    for entry in EXPLANATIONS.values():
        for name in (entry.name, entry.symbol, *entry.aliases):
            if name:
                yield name, entry
