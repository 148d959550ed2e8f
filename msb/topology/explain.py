"""The definition of every number of the audit, as plain data. `msb-audit --explain` prints the definitions.

The file explanations.toml holds the data. The page docs/definitions.md gives the reasons behind the
definitions.
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
        The symbol in formulas, which may be empty.
    title : str
        The quantity in plain words.
    formula : str
        The formula, on one line.
    definition : str
        The counted elements, in two to four sentences.
    matters : str
        The consequence of a high or low value for users of the mesh.
    source : str
        Where the definition comes from: the section of the paper, or the reason for our decision.
    special : str
        Values for empty, degenerate or damaged meshes. The text is empty if no value is special.
    peers : mapping of str to str
        For each library, "agrees" or the exact difference.
    aliases : tuple of str
        Further names that `explain` accepts.
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
        """Yield the label and the text of each part after the definition."""
        yield "Formula", self.formula
        yield "Why it matters", self.matters
        yield "Source", self.source
        if self.special:
            yield "Special cases", self.special
        yield from self.peers.items()

    def to_text(self) -> str:
        """Return the explanation as terminal text, at most 80 columns wide."""
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

    def fill(value: Any) -> Any:
        if isinstance(value, str):
            return Template(value).substitute(texts)
        if isinstance(value, dict):
            return {key: fill(text) for key, text in value.items()}
        return tuple(value)

    return {name: Explanation(name, **{"symbol": "", **fill(entry)}) for name, entry in data.items()}


# Explanations by JSON key. The columns of the paper come first.
EXPLANATIONS: dict[str, Explanation] = _read()


def explain(name: str) -> Explanation:
    """Return the explanation of a quantity of the audit.

    Parameters
    ----------
    name : str
        The key of the quantity in the JSON, or the symbol in formulas. Examples are `nonmanifold_edge_ratio`,
        `metrics.nonmanifold_edge_ratio` (with the enclosing object), `nm_edge_ratio` and `E_gt2`. Upper and
        lower case are not distinguished, and "-" may replace "_".

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
    # `LCC_area` and `lcc_area` are symbols of different quantities. If only the case differs, the name
    # selects the first matching quantity, which is a column of the paper.
    folded: dict[str, Explanation] = {}
    for known, entry in exact.items():
        folded.setdefault(known.casefold(), entry)
    match = exact.get(wanted) or folded.get(wanted.casefold())
    if match is None:
        # Suggest names that contain the text, such as "manifold", or that have a similar spelling. The cutoff
        # 0.7 avoids chance matches.
        near = difflib.get_close_matches(wanted.casefold(), folded, 3, 0.7)
        near += [known for known in folded if len(wanted) > 2 and wanted.casefold() in known]
        near = list(dict.fromkeys(near))[:4]
        hint = f"did you mean {' or '.join(near)}?" if near else f"known names: {', '.join(EXPLANATIONS)}"
        raise UsageError("NAME_UNKNOWN", f'unknown quantity "{shorten(name)}"; {hint}')
    return match
