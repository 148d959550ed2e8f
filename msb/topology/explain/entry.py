"""The class of an explanation."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

KEEPS_ROWS = "agrees, except that it also counts repeated-index rows"
"""A sentence about most peers, which take (a, b, b) as a face with the edges a-b, b-b and b-a."""
SECTION = 'paper, appendix "Topology-Metric Definitions and Interpretation Limits"'


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
