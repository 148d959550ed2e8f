"""The tables on the page of one asset and scene, and what they were measured on."""

from collections.abc import Mapping

from msb.bench.aggregate import METRICS, SCENES
from msb.bench.records import Memory, Result
from msb.report.collect import WALK
from msb.report.layout import line, make_table, number_cell
from msb.report.metric_format import text, title_with_unit
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
from msb.report.table import Cell, Column, Row, Table
from msb.report.tables.bakes import scene_bakes_table, scene_split_table
from msb.report.tables.gaps import scene_gaps_table
from msb.report.tables.measured import DRIVER_NOTE, STRUCTURE_NOTES, connectivity_columns

_TIMES = ("fps", "p50_ms", "p95_ms", "memory", "asset_size")
_BYTES = ("geometry", "appearance", "scratch", "targets", "total")


def asset_tables(place: Place, records: Mapping[str, Result], numbers: Numbers) -> dict[str, Table]:
    """Return the tables "conditions", "gaps", "split", "bakes", "memory", "structure" that have numbers."""
    tables = {}
    known = {key.condition for key in numbers.values if key[:3] == place and not key.of_asset}
    if conditions := [name for name in numbers.conditions(place.dataset) if name in known]:
        walked = any(record.walk is not None for record in records.values())
        tables["conditions"] = make_table(
            numbers,
            None,
            "conditions",
            "Quality, speed and memory under each condition.",
            ("Condition",),
            [
                Column(title_with_unit(metric), (), {"metric": metric})
                for metric in (*QUALITY, *_TIMES, *(WALK if walked else ()))
            ],
            [line(condition=condition) for condition in conditions],
            place._asdict(),
        )
        tables["gaps"] = scene_gaps_table(numbers, place)
    if any(SplitKey(*place, metric) in numbers.splits for metric in QUALITY):
        tables["split"] = scene_split_table(numbers, place)
        tables["bakes"] = scene_bakes_table(numbers, place)
    if held := {name: record.memory for name, record in records.items() if record.memory is not None}:
        tables["memory"] = _memory_table(held)
    audit = records["exported_mesh"].audit if "exported_mesh" in records else None
    if audit is not None:
        tables["structure"] = _structure_table(place, vars(audit.metrics))
    return tables


def _memory_table(held: Mapping[str, Memory]) -> Table:
    by_driver = any(memory.driver_bytes is not None for memory in held.values())
    rows = []
    for condition, memory in held.items():
        own: list[tuple[float | None, str | None]] = [(getattr(memory, name), None) for name in _BYTES]
        own += [(memory.driver_bytes, memory.driver_reason or "not measured")] if by_driver else []
        cells = (number_cell("memory", Number(value, reason=reason)) for value, reason in own)
        rows.append(Row((condition_title(condition),), tuple(cells)))
    names = (*map(str.capitalize, _BYTES), *((METRICS["driver_memory"].title,) if by_driver else ()))
    return Table(
        "memory",
        "Device memory by what it is for, MiB.",
        ("Condition",),
        tuple(map(Column, names)),
        tuple(rows),
        (DRIVER_NOTE,) if by_driver else (),
    )


def _structure_table(place: Place, metrics: Mapping[str, float | None]) -> Table:
    """Return the diagnostics of a mesh, over the paper's mean if that is of the same dataset's scenes."""
    columns = connectivity_columns()

    def cells(values: Mapping[str, float | None]) -> tuple[Cell, ...]:
        own = [(column.of["metric"], values.get(column.of["metric"])) for column in columns]
        return tuple(number_cell(name, Number(value, reason="nothing to divide by")) for name, value in own)

    rows = [Row(("this mesh",), cells(metrics))]
    if place.scene in SCENES.get(place.dataset, ()):
        for method in methods_in("mesh_connectivity"):
            paper = paper_row("mesh_connectivity", dataset=place.dataset, method=method, scene="mean")
            name = f"{method_title(method)}, mean of {dataset_title(place.dataset)} in the paper"
            rows += [Row((name,), cells(paper), paper=True)] if paper else []
    return Table("structure", "The mesh, as stored.", ("",), tuple(columns), tuple(rows), STRUCTURE_NOTES)


def provenance(records: Mapping[str, Result]) -> list[tuple[str, str]]:
    """Return what was measured and with what, as pairs of a name and a value."""
    facts: dict[str, dict[str, None]] = {}

    def add(name: str, value: str | None) -> None:
        if value:
            facts.setdefault(name, {})[value] = None

    for condition, record in records.items():
        asset = "Asset" if record.bake is None else f"Asset, {condition_title(condition)}"
        for name, file in ((asset, record.asset), ("Checkpoint", record.checkpoint)):
            if file is not None:
                digest = f", SHA-256 {file.sha256}" if file.sha256 else ""
                add(name, f"{file.path} ({text('asset_size', file.bytes)} MiB{digest})")
        if record.renderer is not None:
            settings = ", ".join(
                f"{key} = {_plain(value)}" for key, value in record.renderer.settings.items()
            )
            about = f"{record.renderer.name} {record.renderer.version} ({record.renderer.kind})"
            add(condition_title(condition), f"{about}{f'; {settings}' if settings else ''}")
        device = record.drawn_on
        named = [str(device[key]) for key in ("platform", "name") if key in device]
        add("Device", ", ".join([*named, *([f"blends {device['blends']}"] if "blends" in device else [])]))
        if record.bake is not None:
            add(f"Made as {condition_title(condition)}", record.bake.sentence)
        if record.setup is not None:
            background = ", ".join(f"{value:g}" for value in record.setup.background)
            resized = ", resized here" if record.setup.gt_resized else ""
            add("Photographs", f"{record.setup.image_folder}{resized}; background {background}")
            add("Cameras", record.setup.camera_convention)
        if record.quality is not None:
            add("Test views", str(len(record.quality.images)))
        add("Measured with", f"msb {record.tool_version}")
    return [(name, "; ".join(values)) for name, values in facts.items()]


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
