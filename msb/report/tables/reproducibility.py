"""Tables of the differences between our numbers and published numbers."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from msb.bench.aggregate import METRICS
from msb.report.layout import difference_cell, make_table, metric_columns
from msb.report.metric_format import format_digits
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
from msb.report.paper import PUBLISHED_LPIPS
from msb.report.table import NOT_AVAILABLE, Table, TableCell, TableColumn, TableRow
from msb.report.tables.measurements import native_rows

# For each value of `Key.source`, the heading: the method's paper, its public code, the benchmark's paper, or
# this run.
SOURCES = {"paper": "Paper", "public": "Public", "meshsplatbench": "MeshSplatBench paper", "": "This run"}


class PublishedPair(NamedTuple):
    """Our number and the published number, both in the unit of the records.

    `key` is the key of our number, but its `source` is the name of the publication. `notes` contains the
    notes of the published number.
    """

    key: Key
    ours: float
    published: float
    notes: tuple[str, ...] = ()

    @property
    def difference(self) -> float:
        """Our number minus the published number."""
        return self.ours - self.published


def reproducibility(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return a table with a row for each dataset and method, and a block of columns for each source.

    The best value of a block is bold.
    """
    published = {} if paper is None else {key: number for key, number in paper.values.items() if key.source}
    both = numbers if paper is None else Numbers({**numbers.values, **published})
    known = {(key.dataset, key.method) for key in both.values if key.source}
    sources = {key.source for key in both.values if key.dataset in numbers.datasets()}
    return make_table(
        both,
        None,
        "reproducibility",
        "Reproducibility: published results, and ours with the native renderers.",
        ("Dataset", "Method"),
        [
            column
            for source, heading in SOURCES.items()
            if source in sources
            for column in metric_columns(QUALITY, heading, source=source)
        ],
        [row for row in native_rows(numbers) if (row.of["dataset"], row.of["method"]) in known],
        {"scene": MEAN, "condition": "non_engine"},
        best_of=("dataset", "source"),
    )


def pair_with_published(numbers: Numbers, paper: Numbers) -> list[PublishedPair]:
    """Pair our image quality values with the published values.

    `Key.source` of a pair is "paper" (the method's paper), "public" (the method's public code) or
    "meshsplatbench" (the benchmark's paper). If a mean covers only some of the scenes, it is not compared.
    """
    pairs = []
    for key, published in paper.values.items():
        if published.value is None or key.metric not in QUALITY or key.source == "meshsplatbench":
            continue
        ours = numbers.number(key._replace(source=""))
        if ours.value is not None and ours.present == ours.expected:
            source = key.source or "meshsplatbench"
            notes = tuple(note for note in published.notes if note != PUBLISHED_LPIPS)
            pairs.append(PublishedPair(key._replace(source=source), ours.value, published.value, notes))
    return pairs


def list_notes(pairs: Iterable[PublishedPair]) -> list[str]:
    """Return the notes of published numbers without repetition."""
    return list(dict.fromkeys(note for pair in pairs for note in pair.notes))


def reproducibility_statistics(numbers: Numbers, paper: Numbers) -> Table:
    """Return a table of statistics of the differences d = ours - published. Each source and metric has a row.

    The columns are the number of pairs, mean |d|, max |d|, and the pair with the largest |d|.
    """
    # group the pairs by publication, by metric, and by single scenes or means
    groups: dict[tuple[str, bool, str], list[PublishedPair]] = {}
    for pair in pair_with_published(numbers, paper):
        groups.setdefault((pair.key.source, pair.key.scene in MEANS, pair.key.metric), []).append(pair)
    lpips = any(metric == "lpips" and source in ("paper", "public") for source, _, metric in groups)
    order = [(source, means, metric) for source in SOURCES for means in (False, True) for metric in QUALITY]
    return Table(
        "reproducibility_statistics",
        "Differences from published results, d = ours - published, over all pairs of values.",
        ("Compared with", "Of", "Metric"),
        tuple(map(TableColumn, ("n", "mean |d|", "max |d|", "max |d| / published (%)", "Worst pair"))),
        tuple(_statistics_row(*group, groups[group]) for group in order if group in groups),
        (
            "means that cover only some of the scenes are not compared",
            *([f"LPIPS: {PUBLISHED_LPIPS}"] if lpips else []),
            *list_notes(
                pair for group in groups.values() for pair in group if pair.key.source != "meshsplatbench"
            ),
        ),
    )


def _statistics_row(source: str, means: bool, metric: str, pairs: list[PublishedPair]) -> TableRow:
    worst = max(pairs, key=lambda pair: abs(pair.difference))
    mean = math.fsum(abs(pair.difference) for pair in pairs) / len(pairs)
    relative = max(
        (100 * abs(pair.difference / pair.published) for pair in pairs if pair.published), default=None
    )
    key = worst.key
    where = [method_title(key.method), dataset_title(key.dataset)]
    where += [] if key.scene == MEAN else [scene_title(key.scene)]
    where += [] if key.condition == "non_engine" else [condition_title(key.condition)]
    signed = format_digits(worst.difference, METRICS[metric].decimals + 1, sign=True)
    cells = (
        TableCell(str(len(pairs)), float(len(pairs))),
        difference_cell(metric, mean, sign=False, more=1),
        difference_cell(metric, abs(worst.difference), sign=False, more=1),
        TableCell(NOT_AVAILABLE) if relative is None else TableCell(f"{relative:.2f}", relative, metric, "%"),
        TableCell(f"{', '.join(where)} ({signed})", ", ".join(where)),
    )
    return TableRow(
        (SOURCES[source], "means of datasets" if means else "scenes", METRICS[metric].title), cells
    )
