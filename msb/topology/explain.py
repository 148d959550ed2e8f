"""The definition of every number of the audit, as plain data: what `msb-audit --explain` prints.

The data is explanations.toml; docs/definitions.md holds the reasoning behind it, and the data on the site.
"""

import difflib
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

from msb.errors import UsageError, shorten


@dataclass(frozen=True)
class Explanation:
    """The meaning of one quantity of the audit.

    Attributes
    ----------
    name : str
        The key in the audit's JSON.
    symbol : str
        The name in formulas; empty if there is none.
    title : str
        The quantity in plain words.
    formula : str
        The formula, on one line.
    definition : str
        What is counted, in two to four sentences.
    matters : str
        What a high or low value means for whoever uses the mesh.
    source : str
        Where the definition comes from: the paper's section, or why it was decided here.
    special : str
        What holds for empty, degenerate or broken meshes; empty if nothing special does.
    peers : mapping of str to str
        Library -> "agrees", or exactly how it differs.
    aliases : tuple of str
        Other names that `explain` takes for the quantity.
    """

    name: str
    symbol: str
    title: str
    formula: str
    definition: str
    matters: str
    source: str
    special: str = ""
    peers: Mapping[str, str] = field(default_factory=dict)
    aliases: tuple[str, ...] = ()

    def paragraphs(self) -> Iterator[tuple[str, str]]:
        """Yield label and text of everything after the definition."""
        yield "Formula", self.formula
        yield "Why it matters", self.matters
        yield "Source", self.source
        if self.special:
            yield "Special cases", self.special
        yield from self.peers.items()

    def to_text(self) -> str:
        """Return the explanation for a terminal, at most 80 columns wide."""
        head = f"{self.name} ({self.symbol})" if self.symbol not in {"", self.name} else self.name
        lines = textwrap.wrap(f"{head}: {self.title}", 80)
        lines += ["", *textwrap.wrap(self.definition, 80), ""]
        for label, text in self.paragraphs():
            lines += textwrap.wrap(f"{label}: {text}", 80, subsequent_indent="  ", break_on_hyphens=False)
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the explanation as JSON data."""
        return {**vars(self), "peers": dict(self.peers), "aliases": list(self.aliases)}


def _read() -> dict[str, Explanation]:
    data = tomllib.loads(Path(__file__).with_name("explanations.toml").read_text("utf-8"))
    texts = data.pop("texts")

    def filled(value: Any) -> Any:
        if isinstance(value, str):
            return Template(value).substitute(texts)
        if isinstance(value, dict):
            return {key: filled(one) for key, one in value.items()}
        return tuple(value)

    return {name: Explanation(name, **{"symbol": "", **filled(entry)}) for name, entry in data.items()}


# Name in the JSON -> explanation; the paper's columns first.
EXPLANATIONS: dict[str, Explanation] = _read()


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
    wanted = name.strip().replace("-", "_").removeprefix("welded.").removeprefix("without_seams.")
    wanted = wanted.removeprefix("counts.").removeprefix("metrics.")
    exact = {
        known: entry
        for entry in EXPLANATIONS.values()
        for known in (entry.name, entry.symbol, *entry.aliases)
        if known
    }
    # LCC_area and lcc_area are two symbols: without the right case it is the first one, the paper's column.
    folded: dict[str, Explanation] = {}
    for known, entry in exact.items():
        folded.setdefault(known.casefold(), entry)
    match = exact.get(wanted) or folded.get(wanted.casefold())
    if match is None:
        near = difflib.get_close_matches(wanted.casefold(), folded, 3, 0.5)
        hint = f"did you mean {' or '.join(near)}" if near else f"the names are {', '.join(EXPLANATIONS)}"
        raise UsageError("NAME_UNKNOWN", f'there is no quantity "{shorten(name)}"; {hint}')
    return match
