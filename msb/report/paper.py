"""The paper's own numbers, to be set beside ours."""

from __future__ import annotations

import json
from importlib import resources


def paper_row(table: str, **where: str) -> dict[str, float]:
    """Return metric -> printed value of the row of a paper table that `where` selects.

    Parameters
    ----------
    table : str
        Label without its prefix, as in ``paper_tables/mesh_connectivity.json``.
    **where : str
        Cell keys and the values they must have, such as ``scene="mean"``.

    Returns
    -------
    dict of str to float
        In units of 1: counts printed in millions are scaled.

    Examples
    --------
    >>> paper_row("mesh_connectivity", scene="mean")["mean_valence"]
    6.49
    """
    text = resources.files("msb.report").joinpath("paper_tables", f"{table}.json").read_text("utf-8")
    row = {}
    for cell in json.loads(text)["cells"]:
        if all(cell[key] == value for key, value in where.items()):
            name = _OUR_NAMES.get(cell["metric"], cell["metric"])
            row[name] = cell["value"] * float(cell["unit"])
    return row


_OUR_NAMES = {"v_over_f": "vf_ratio", "valence": "mean_valence"}
"""Where a table's metric has another name than the audit's JSON (DESIGN: msb-audit)."""
