"""How near our numbers come to published ones."""

import math
from typing import NamedTuple

from msb.bench.aggregate import METRICS
from msb.report.layout import difference_cell, make_table, metric_columns
from msb.report.metric_format import digits
from msb.report.numbers import (
    MEAN,
    MEANS,
    QUALITY,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.paper import LPIPS_ELSEWHERE
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.tables.measured import native_lines

# `Key.source` -> its heading: a method's own paper, its public code, the benchmark's paper, and ours.
SOURCES = {"paper": "Paper", "public": "Public", "meshsplatbench": "MeshSplatBench paper", "": "This run"}


class Pair(NamedTuple):
    """A number of ours and the published one, both in the records' unit."""

    # The key of our number; its `source` says what the number is compared with.
    key: Key
    ours: float
    published: float

    @property
    def difference(self) -> float:
        """Our number minus the published one."""
        return self.ours - self.published


def reproducibility(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return a row per dataset and method, a block per source; in it a dataset's best is bold."""
    published = {} if paper is None else {key: number for key, number in paper.values.items() if key.source}
    both = numbers if paper is None else Numbers({**numbers.values, **published})
    known = {(key.dataset, key.method) for key in both.values if key.source}
    sources = {key.source for key in both.values}
    return make_table(
        both,
        None,
        "reproducibility",
        "Reproducibility: published results, and ours with the methods' own renderers.",
        ("Dataset", "Method"),
        [
            column
            for source, heading in SOURCES.items()
            if source in sources
            for column in metric_columns(QUALITY, heading, source=source)
        ],
        [line for line in native_lines(numbers) if (line.of["dataset"], line.of["method"]) in known],
        {"scene": MEAN, "condition": "non_engine"},
        best_of=("dataset", "source"),
    )


def pairs(numbers: Numbers, paper: Numbers) -> list[Pair]:
    """Return every quality number of ours of which a published one exists.

    With a method's paper and its public code, where those are known (`Key.source` "paper", "public"), and
    with the benchmark's paper, whatever it prints ("meshsplatbench"). A partial mean is compared with
    nothing.
    """
    both = []
    for key, published in paper.values.items():
        if published.value is None or key.metric not in QUALITY or key.source == "meshsplatbench":
            continue
        ours = numbers.number(key._replace(source=""))
        if ours.value is not None and ours.present == ours.expected:
            source = key.source or "meshsplatbench"
            both.append(Pair(key._replace(source=source), ours.value, published.value))
    return both


def reproducibility_statistics(numbers: Numbers, paper: Numbers) -> Table:
    """Return n, mean |d|, max |d| and the worst pair of each metric and source (d = ours - published)."""
    groups: dict[tuple[str, bool, str], list[Pair]] = {}
    for pair in pairs(numbers, paper):
        groups.setdefault((pair.key.source, pair.key.scene in MEANS, pair.key.metric), []).append(pair)
    lpips = any(metric == "lpips" and source in ("paper", "public") for source, _, metric in groups)
    order = [(source, means, metric) for source in SOURCES for means in (False, True) for metric in QUALITY]
    return Table(
        "reproducibility_statistics",
        "Differences from published results, d = ours - published, over all pairs of which both are known.",
        ("Compared with", "Of", "Metric"),
        tuple(map(Column, ("n", "mean |d|", "max |d|", "max |d| / published (%)", "Worst pair"))),
        tuple(_statistics_row(*group, groups[group]) for group in order if group in groups),
        ("a partial mean is compared with nothing", *([f"LPIPS: {LPIPS_ELSEWHERE}"] if lpips else [])),
    )


def _statistics_row(source: str, means: bool, metric: str, own: list[Pair]) -> Row:
    worst = max(own, key=lambda pair: abs(pair.difference))
    mean = math.fsum(abs(pair.difference) for pair in own) / len(own)
    relative = max(
        (100 * abs(pair.difference / pair.published) for pair in own if pair.published), default=None
    )
    key = worst.key
    where = [method_title(key.method), dataset_title(key.dataset)]
    where += [] if key.scene == MEAN else [scene_title(key.scene)]
    where += [] if key.condition == "non_engine" else [condition_title(key.condition)]
    signed = digits(worst.difference, METRICS[metric].decimals + 1, sign=True)
    cells = (
        Cell(str(len(own)), float(len(own))),
        difference_cell(metric, mean, sign=False, more=1),
        difference_cell(metric, abs(worst.difference), sign=False, more=1),
        Cell(NOT_THERE) if relative is None else Cell(f"{relative:.2f}", relative, metric, "%"),
        Cell(f"{', '.join(where)} ({signed})", ", ".join(where)),
    )
    return Row((SOURCES[source], "means of datasets" if means else "scenes", METRICS[metric].title), cells)
