"""Read the published numbers of the paper from JSON files of its tables."""

import json
import os
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from msb.bench.aggregate import METRICS
from msb.bench.gaps import Gaps, Ratio, value_gaps
from msb.bench.validation import read_json, validate
from msb.registry import METHODS, NO_TRIANGLES, Method, Retained, Tier
from msb.report.numbers import (
    DRAWN_CONDITIONS,
    MEAN,
    QUALITY,
    GapKey,
    Key,
    Number,
    Numbers,
    RatioKey,
    dataset_title,
    method_title,
)
from msb.report.table import NOT_AVAILABLE

# Labels of the paper's tables with numbers. Features of methods are read from `msb.registry` and not from the
# paper.
PAPER_TABLES = (
    "native_summary",
    "native_comprehensive_results",
    "mip360_renderer_comparison",
    "tnt_renderer_comparison",
    "tnt_unity_runtime_resources",
    "mip360_unity_gpu_latency",
    "mip360_unity_memory",
    "mesh_connectivity",
    "reproducibility_comparison",
)

# For each method name in the paper, our name of the method. Built-in methods are stored last. If a method of
# another package has the same paper name, the built-in method replaces it.
OUR_METHODS = {method.paper_name: name for name, method in reversed([*METHODS.items()]) if method.paper_name}
# For each metric name in the paper that differs from ours, our metric name (a key of
# `msb.bench.aggregate.METRICS`).
_OUR_METRICS = {
    "gpu_ms_p50": "p50_ms",
    "gpu_ms_p95": "p95_ms",
    "vram": "memory",
    "train_peak_mem": "train_memory",
    "train_time": "train_seconds",
    "v_over_f": "vf_ratio",
    "valence": "mean_valence",
}

ENGINE_MEMORY = (
    "not comparable with our memory, which counts every buffer. The paper's Standard memory is nearly equal "
    "for all methods and smaller than the meshes, so it must exclude the mesh"
)

ENGINE_RENDERING = (
    "the paper rendered Dedicated with an engine, but our Dedicated follows the official code. The "
    'comparable condition is a variant with order = "global" and sampling = "engine"'
)
PUBLISHED_LPIPS = "LPIPS as published; its network, version or scaling of the images may differ from ours"


# The publication that contains a number: a key of `msb.report.tables.reproducibility.SOURCES`.
Source = Literal["", "paper", "public", "meshsplatbench"]


class _PublishedCell(BaseModel):
    """A cell of a published table, with the names and units of the paper.

    `na` is the text that the paper prints in place of a missing value.
    """

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, strict=True)

    dataset: Annotated[str, Field(min_length=1, max_length=200)]
    scene: Annotated[str, Field(min_length=1, max_length=200)]
    method: str
    condition: str
    metric: str
    value: float | None
    unit: str = "1"
    source: Source = ""
    na: Literal["N/A", "--"] = "--"


class _PublishedTable(BaseModel):
    """The cells of a published table (schema msb-paper-table/1)."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)

    schema_: Literal["msb-paper-table/1"] = Field(alias="schema")
    # A footnote of every number in the table.
    note: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    cells: tuple[_PublishedCell, ...]


def paper_numbers(*tables: str) -> Numbers:
    """Return the numbers of the paper's tables. The order is the paper's order.

    `tables` are labels of tables. By default, all tables are read. If two tables contain different numbers
    for one key, both numbers are kept. The values of `Key.source` are different for the two numbers.
    """
    values: dict[Key, Number] = {}
    for label in tables or PAPER_TABLES:
        for key, number in _read_table(label).items():
            values.setdefault(key, number)
    drawn_by: dict[str, dict[str, str]] = {}
    for key in values:
        name = "their own code" if key.condition == "non_engine" else "Unity"
        drawn_by.setdefault(key.dataset, {})[key.condition] = name
    numbers = Numbers(values, drawn_by=drawn_by, of_paper=True)
    return replace(numbers, gaps=_compute_gaps(numbers), ratios=_compute_ratios(numbers))


def paper_row(table: str, **where: str) -> dict[str, float]:
    """Return the printed values of one row of a paper table. The keys are metrics.

    The fields in `where` select the row.

    Parameters
    ----------
    table : str
        Label without its prefix, as in ``paper_tables/mesh_connectivity.json``.
    **where : str
        The fields of `Key` with their required values, such as ``scene="mean"``.

    Returns
    -------
    dict of str to float
        Values in units of 1; counts printed in millions are converted.

    Examples
    --------
    >>> paper_row("mesh_connectivity", scene="mean")["mean_valence"]
    6.49
    """
    return {
        key.metric: number.value
        for key, number in _read_table(table).items()
        if number.value is not None and all(getattr(key, name) == value for name, value in where.items())
    }


def methods_in(table: str) -> list[str]:
    """Return the methods in a table of the paper. `table` is a label as in `paper_row`."""
    return list(dict.fromkeys(key.method for key in _read_table(table)))


def published_numbers(path: str | os.PathLike[str]) -> dict[Key, Number]:
    """Return published numbers from a JSON file with the schema of ``paper_tables/*.json``.

    A file of published values can contain single scenes, which are missing in the paper. `Key.source` is
    "paper" unless the file names another source. The note of the file is added to every number.
    """
    table = validate(_PublishedTable, read_json(path, 1 << 24), file=Path(path), code="RECORD_INVALID")
    notes = () if table.note is None else (table.note,)
    numbers = {}
    for cell in table.cells:
        if cell.value is not None and (cell.metric in METRICS or cell.metric in _OUR_METRICS):
            key, number = _convert_cell(cell)
            numbers[key._replace(source=key.source or "paper")] = replace(number, notes=notes)
    return numbers


def contradictions() -> dict[str, list[str]]:
    """Return notes on statements of the paper that contradict a table.

    The keys are the labels of the tables.
    """
    notes: dict[str, list[str]] = json.loads(_read_text("contradictions"))
    return notes


def _read_text(name: str) -> str:
    return resources.files("msb.report").joinpath("paper_tables", f"{name}.json").read_text("utf-8")


@cache
def _read_table(label: str) -> dict[Key, Number]:
    cells = _PublishedTable.model_validate_json(_read_text(label)).cells
    return {key: _add_notes(key, number) for key, number in map(_convert_cell, cells)}


def _convert_cell(cell: _PublishedCell) -> tuple[Key, Number]:
    """Return a published table cell with our names and in the unit of the records."""
    metric = _OUR_METRICS.get(cell.metric, cell.metric)
    method = OUR_METHODS.get(cell.method, cell.method)
    key = Key(cell.dataset, cell.scene, method, cell.condition, metric, cell.source)
    scale = 1e6 if cell.unit == "1e6" else METRICS[metric].scale
    return key, Number(None if cell.value is None else cell.value * scale, cell.na)


def as_in_paper(method: Method) -> Method:
    """Return the features of a method as the paper prints them. The paper does not render Gaussians."""
    if method.primitive == "triangle":
        return method
    retained: dict[Tier, Retained] = {
        tier: kept for tier, kept in method.retained.items() if tier == "standard"
    }
    return replace(
        method, native=None, retained=retained, unsupported={**method.unsupported, "dedicated": NO_TRIANGLES}
    )


def _add_notes(key: Key, number: Number) -> Number:
    """Add notes that explain why a number of the paper is not comparable with our numbers."""
    if number.value is None:
        if key.source != "paper" or number.absent != NOT_AVAILABLE:
            return number
        reason = f"the paper of {method_title(key.method)} reports no results on {dataset_title(key.dataset)}"
        return replace(number, reason=reason)
    # Mark values of other engines and LPIPS from other sources, which are not comparable with our values.
    if key.metric == "memory" and key.condition == "standard":
        return Number(number.value, notes=(ENGINE_MEMORY,))
    if key.condition == "dedicated" and (key.metric in QUALITY or key.metric == "fps"):
        return Number(number.value, notes=(ENGINE_RENDERING,))
    if key.metric == "lpips" and key.source in ("paper", "public"):
        return Number(number.value, notes=(PUBLISHED_LPIPS,))
    # Add the notes that a method declares about its published native results.
    if key.condition != "non_engine" or key.source not in ("", "meshsplatbench"):
        return number
    known = METHODS[key.method].paper_notes if key.method in METHODS else ()
    notes = (note for note in known if key.metric in note.metrics and note.dataset in (None, key.dataset))
    return replace(number, notes=tuple(note.text for note in notes))


def _compute_gaps(numbers: Numbers) -> dict[GapKey, Gaps]:
    """Return the quality gaps between the paper's averages."""
    all_gaps: dict[GapKey, Gaps] = {}
    for dataset in numbers.datasets():
        for method in numbers.methods(dataset):
            for metric in QUALITY:
                keys = (Key(dataset, MEAN, method, condition, metric) for condition in DRAWN_CONDITIONS)
                gaps = value_gaps(metric, *map(numbers.value, keys))
                if any(gap.value is not None for gap in (gaps.adapt, gaps.port, gaps.deploy)):
                    all_gaps[GapKey(dataset, MEAN, method, metric)] = gaps
    return all_gaps


def _compute_ratios(numbers: Numbers) -> dict[RatioKey, Ratio]:
    """Return the ratios of the paper's frame rates.

    If the paper prints values of single scenes, the ratios of these scenes are included.
    """
    ratios = {}
    for above, below in (("standard", "dedicated"), ("dedicated", "non_engine")):
        for dataset in numbers.datasets():
            for method in numbers.methods(dataset, above):
                of_scenes = {}
                for scene in (MEAN, *numbers.scenes(dataset)):
                    key = Key(dataset, scene, method, above, "fps")
                    rate, under = numbers.value(key), numbers.value(key._replace(condition=below))
                    if rate is not None and under:
                        of_scenes[scene] = rate / under
                if (mean := of_scenes.pop(MEAN, None)) is not None:
                    where = RatioKey(dataset, method, above, below)
                    ratios[where] = Ratio(mean, None, of_scenes, len(of_scenes))
    return ratios
