"""How near our numbers come to published ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from msb.report.layout import Layout, Line, make_table
from msb.report.metric_format import SHOWN, digits, title
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
from msb.report.table import NOT_THERE, Cell, Column, Row, Table

SOURCES = {"paper": "Paper", "public": "Public", "meshsplatbench": "MeshSplatBench paper", "": "This run"}
"""`Key.source` -> its heading: a method's own paper, its public code, the benchmark's paper, and ours."""


class Pair(NamedTuple):
    """A number of ours and the published one, both in the records' unit."""

    key: Key
    """The key of our number; its `source` says what the number is compared with."""
    ours: float
    published: float

    @property
    def difference(self) -> float:
        """Our number minus the published one."""
        return self.ours - self.published


def reproducibility(
    numbers: Numbers,
    paper: Numbers | None = None,
    *,
    label: str = "reproducibility",
    sources: tuple[str, ...] = tuple(SOURCES),
) -> Table:
    """Return a row per dataset and method, a block per source; in it a dataset's best is bold."""
    both = numbers if paper is None else _with_published(numbers, paper)
    known = {(key.dataset, key.method) for key in both.values if key.source}
    lines = [
        Line(
            (dataset_title(dataset), method_title(method)),
            tuple(
                Key(dataset, MEAN, method, "non_engine", metric, source)
                for source in sources
                for metric in QUALITY
            ),
        )
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset, "non_engine")
        if (dataset, method) in known
    ]
    return make_table(
        Layout(
            label,
            "Reproducibility: published results, and ours with the methods' own renderers.",
            ("Dataset", "Method"),
            tuple(Column(title(metric), (SOURCES[source],)) for source in sources for metric in QUALITY),
            tuple(lines),
            best_of=lambda key: (key.dataset, key.source),
        ),
        both,
    )


def pairs(numbers: Numbers, paper: Numbers) -> list[Pair]:
    """Return every quality number of ours of which a published one exists.

    With a method's paper and its public code, where those are known (`Key.source` "paper", "public"), and
    with the benchmark's paper, whatever it prints ("meshsplatbench"). A partial mean is compared with
    nothing.
    """
    found = []
    for key, published in paper.values.items():
        if published.value is None or key.metric not in QUALITY or key.source == "meshsplatbench":
            continue
        ours = numbers.number(key._replace(source=""))
        if ours.value is not None and ours.present == ours.expected:
            source = key.source or "meshsplatbench"
            found.append(Pair(key._replace(source=source), ours.value, published.value))
    return found


def reproducibility_statistics(numbers: Numbers, paper: Numbers) -> Table:
    """Return n, mean |d|, max |d| and the worst pair of each metric and source (d = ours - published)."""
    rows = tuple(_statistics(pairs(numbers, paper)))
    return Table(
        "reproducibility_statistics",
        "Differences from published results, d = ours - published, over all pairs of which both are known.",
        ("Compared with", "Of", "Metric"),
        tuple(map(Column, ("n", "mean |d|", "max |d|", "max |d| / published (%)", "Worst pair"))),
        rows,
        ("a partial mean is compared with nothing",),
    )


def _statistics(found: list[Pair]) -> Iterator[Row]:
    for source in SOURCES:
        for means in (False, True):
            for metric in QUALITY:
                own = [
                    pair
                    for pair in found
                    if (pair.key.source, pair.key.metric) == (source, metric)
                    and (pair.key.scene in MEANS) == means
                ]
                if own:
                    yield _statistics_row(source, means, metric, own)


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
    unit, decimals = SHOWN[metric].unit, SHOWN[metric].decimals + 1
    cells = (
        Cell(str(len(own)), float(len(own))),
        Cell(f"{mean:.{decimals}f}", mean, metric, unit),
        Cell(f"{abs(worst.difference):.{decimals}f}", abs(worst.difference), metric, unit),
        Cell(NOT_THERE) if relative is None else Cell(f"{relative:.2f}", relative, metric, "%"),
        Cell(f"{', '.join(where)} ({digits(worst.difference, decimals, sign=True)})", ", ".join(where)),
    )
    of = "means of datasets" if means else "scenes"
    return Row((SOURCES[source], of, SHOWN[metric].title), cells)


def _with_published(numbers: Numbers, paper: Numbers) -> Numbers:
    published = {key: number for key, number in paper.values.items() if key.source}
    return Numbers({**numbers.values, **published})
