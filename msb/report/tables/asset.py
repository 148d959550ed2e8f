"""The tables on the page of one asset. The page also lists the origins of the asset's numbers."""

from collections.abc import Mapping

from msb.bench.aggregate import METRICS, SCENES
from msb.bench.records import Memory, Result
from msb.report.collect import WALK
from msb.report.layout import make_table, number_cell, titled_row
from msb.report.metric_format import format_value, metric_title_with_unit
from msb.report.numbers import (
    QUALITY,
    Number,
    Numbers,
    SplitKey,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.paper import methods_in, paper_row
from msb.report.results import Place
from msb.report.table import Table, TableCell, TableColumn, TableRow
from msb.report.tables.bakes import scene_bakes_table, scene_split_table
from msb.report.tables.gaps import scene_gaps_table
from msb.report.tables.measurements import DRIVER_NOTE, STRUCTURE_NOTES, connectivity_columns

_COSTS = ("fps", "p50_ms", "p95_ms", "memory", "asset_size")
# Attributes of the class `Memory`, in bytes.
_MEMORY_PARTS = ("geometry", "appearance", "scratch", "targets", "total")


def asset_tables(place: Place, records: Mapping[str, Result], numbers: Numbers) -> dict[str, Table]:
    """Return the tables of an asset that have values.

    Parameters
    ----------
    place : Place
    records : mapping of str to Result
        The record of each condition.
    numbers : Numbers
        The numbers of all results.

    Returns
    -------
    dict of str to Table
        Keys: "conditions", "gaps", "split", "bakes", "memory", "structure".
    """
    tables = {}
    known = {key.condition for key in numbers.values if key[:3] == place and not key.is_of_asset}
    if conditions := [name for name in numbers.conditions(place.dataset) if name in known]:
        walked = any(record.walk is not None for record in records.values())
        tables["conditions"] = make_table(
            numbers,
            None,
            "conditions",
            "Quality, speed and memory under each condition.",
            ("Condition",),
            [
                TableColumn(metric_title_with_unit(metric), (), {"metric": metric})
                for metric in (*QUALITY, *_COSTS, *(WALK if walked else ()))
            ],
            [titled_row(condition=condition) for condition in conditions],
            place._asdict(),
        )
        tables["gaps"] = scene_gaps_table(numbers, place)
    if any(SplitKey(*place, metric) in numbers.splits for metric in QUALITY):
        tables["split"] = scene_split_table(numbers, place)
        tables["bakes"] = scene_bakes_table(numbers, place)
    if memory := {name: record.memory for name, record in records.items() if record.memory is not None}:
        tables["memory"] = _memory_table(memory)
    audit = records["exported_mesh"].audit if "exported_mesh" in records else None
    if audit is not None:
        tables["structure"] = _structure_table(place, vars(audit.metrics))
    return tables


def _memory_table(memory: Mapping[str, Memory]) -> Table:
    """Return the table of device memory by purpose. For each condition, `memory` contains the bytes."""
    by_driver = any(used.driver_bytes is not None for used in memory.values())
    rows = []
    for condition, used in memory.items():
        parts: list[tuple[float | None, str | None]] = [(getattr(used, name), None) for name in _MEMORY_PARTS]
        parts += [(used.driver_bytes, used.driver_reason or "not measured")] if by_driver else []
        cells = (number_cell("memory", Number(value, reason=reason)) for value, reason in parts)
        rows.append(TableRow((condition_title(condition),), tuple(cells)))
    names = (*map(str.capitalize, _MEMORY_PARTS), *((METRICS["driver_memory"].title,) if by_driver else ()))
    return Table(
        "memory",
        "Device memory by purpose, in MiB.",
        ("Condition",),
        tuple(map(TableColumn, names)),
        tuple(rows),
        (DRIVER_NOTE,) if by_driver else (),
    )


def _structure_table(place: Place, metrics: Mapping[str, float | None]) -> Table:
    """Return the connectivity metrics of a mesh, with the paper's means for the same dataset."""
    columns = connectivity_columns()

    def cells(values: Mapping[str, float | None]) -> tuple[TableCell, ...]:
        names = [column.of["metric"] for column in columns]
        reason = "not defined for this mesh: division by zero"
        return tuple(number_cell(name, Number(values.get(name), reason=reason)) for name in names)

    rows = [TableRow(("this mesh",), cells(metrics))]
    if place.scene in SCENES.get(place.dataset, ()):
        for method in methods_in("mesh_connectivity"):
            paper = paper_row("mesh_connectivity", dataset=place.dataset, method=method, scene="mean")
            name = f"{method_title(method)}, mean of {dataset_title(place.dataset)} in the paper"
            rows += [TableRow((name,), cells(paper), paper=True)] if paper else []
    caption = "Connectivity of the mesh as stored, without any repair."
    return Table("structure", caption, ("",), tuple(columns), tuple(rows), STRUCTURE_NOTES)


def provenance(records: Mapping[str, Result]) -> list[tuple[str, str]]:
    """Return (name, value) pairs about files, renderers, devices and settings for the page of an asset."""
    facts: dict[str, dict[str, None]] = {}

    def add(name: str, value: str | None) -> None:
        if value:
            facts.setdefault(name, {})[value] = None

    for condition, record in records.items():
        # Add the files with size and hash.
        asset = "Asset" if record.bake is None else f"Asset, {condition_title(condition)}"
        for name, file in ((asset, record.asset), ("Checkpoint", record.checkpoint)):
            if file is not None:
                digest = f", SHA-256 {file.sha256}" if file.sha256 else ""
                add(name, f"{file.path} ({format_value('asset_size', file.bytes)} MiB{digest})")
        # Renderer and device.
        if record.renderer is not None:
            settings = ", ".join(
                f"{key} = {_format_setting(value)}" for key, value in record.renderer.settings.items()
            )
            about = f"{record.renderer.name} {record.renderer.version} ({record.renderer.kind})"
            add(condition_title(condition), f"{about}{f'; {settings}' if settings else ''}")
        device = record.drawn_on
        parts = [str(device[key]) for key in ("platform", "name") if key in device]
        parts += [f"blends in {device['blends']}"] if "blends" in device else []
        add("Device", ", ".join(parts))
        if record.bake is not None:
            add(f"Bake of {condition_title(condition)}", record.bake.sentence)
        # Add photographs, cameras and test views.
        if record.setup is not None:
            background = ", ".join(f"{value:g}" for value in record.setup.background)
            resized = ", resized here" if record.setup.gt_resized else ""
            add("Photographs", f"{record.setup.image_folder}{resized}; background {background}")
            add("Cameras", record.setup.camera_convention)
        if record.quality is not None:
            add("Test views", str(len(record.quality.images)))
        add("Measured with", f"msb {record.tool_version}")
    return [(name, "; ".join(values)) for name, values in facts.items()]


def _format_setting(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
