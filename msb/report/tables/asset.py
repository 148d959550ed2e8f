"""The tables on the page of one asset and scene, and what they were measured on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from msb.report.layout import Layout, Line, make_table
from msb.report.metric_format import SHOWN, printed_value, text, title, title_with_unit
from msb.report.numbers import QUALITY, Key, condition_title, method_title
from msb.report.paper import methods_in, paper_row
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.tables.gaps import scene_gaps_table
from msb.report.tables.runtime import DRIVER_NOTE
from msb.report.tables.structure import CONNECTIVITY

if TYPE_CHECKING:
    from msb.bench.records import Memory, Result
    from msb.report.numbers import Numbers
    from msb.report.results import Place

_MIB = float(1 << 20)
_TIMES = ("fps", "p50_ms", "p95_ms", "memory", "asset_size")
_BYTES = ("geometry", "appearance", "scratch", "targets")


def asset_tables(place: Place, records: Mapping[str, Result], numbers: Numbers) -> dict[str, Table]:
    """Return the tables "conditions", "gaps", "memory" and "structure" of an asset that have numbers."""
    found = {}
    conditions = [
        condition for condition in numbers.conditions(place.dataset) if (*place, condition) in _known(numbers)
    ]
    if conditions:
        found["conditions"] = make_table(
            Layout(
                "conditions",
                "Quality, speed and memory under each condition.",
                ("Condition",),
                tuple(Column(title_with_unit(metric)) for metric in (*QUALITY, *_TIMES)),
                tuple(
                    Line(
                        (condition_title(condition),),
                        tuple(Key(*place, condition, metric) for metric in (*QUALITY, *_TIMES)),
                    )
                    for condition in conditions
                ),
            ),
            numbers,
        )
        found["gaps"] = scene_gaps_table(numbers, place)
    held = {condition: record.memory for condition, record in records.items() if record.memory is not None}
    if held:
        told = any(memory.driver_bytes is not None for memory in held.values())
        rows = tuple(
            Row(
                (condition_title(condition),),
                tuple(_bytes(getattr(memory, name)) for name in (*_BYTES, "total"))
                + ((_by_the_driver(memory),) if told else ()),
            )
            for condition, memory in held.items()
        )
        names = (*map(str.capitalize, (*_BYTES, "total")), *((SHOWN["driver_memory"].title,) if told else ()))
        found["memory"] = Table(
            "memory",
            "Device memory by what it is for, MiB.",
            ("Condition",),
            tuple(map(Column, names)),
            rows,
            (DRIVER_NOTE,) if told else (),
        )
    audit = records["exported_mesh"].audit if "exported_mesh" in records else None
    if audit is not None:
        metrics = [metric for block in CONNECTIVITY.values() for metric in block]
        heads = tuple(
            Column(title(metric), (block,)) for block, own in CONNECTIVITY.items() for metric in own
        )
        paper = paper_row("mesh_connectivity", scene="mean")
        rows = (
            Row(("this mesh",), tuple(_metric(metric, getattr(audit.metrics, metric)) for metric in metrics)),
            Row(
                (f"{', '.join(map(method_title, methods_in('mesh_connectivity')))}, mean in the paper",),
                tuple(_metric(metric, paper[metric]) for metric in metrics),
                paper=True,
            ),
        )
        found["structure"] = Table("structure", "The mesh, as stored.", ("",), heads, rows)
    return found


def provenance(records: Mapping[str, Result]) -> list[tuple[str, str]]:
    """Return what was measured and with what, as pairs of a name and a value."""
    found: dict[str, dict[str, None]] = {}

    def add(name: str, value: str | None) -> None:
        if value:
            found.setdefault(name, {})[value] = None

    for condition, record in records.items():
        for name, file in (("Asset", record.asset), ("Checkpoint", record.checkpoint)):
            if file is not None:
                digest = f", SHA-256 {file.sha256}" if file.sha256 else ""
                add(name, f"{file.path} ({text('asset_size', file.bytes)} MiB{digest})")
        if record.renderer is not None:
            settings = ", ".join(
                f"{key} = {_plain(value)}" for key, value in record.renderer.settings.items()
            )
            about = f"{record.renderer.name} {record.renderer.version} ({record.renderer.kind})"
            add(condition_title(condition), f"{about}{f'; {settings}' if settings else ''}")
        device = (record.device or {}).get("device")
        if isinstance(device, dict):
            add("Device", ", ".join(str(device[key]) for key in ("platform", "name") if key in device))
        if record.setup is not None:
            background = ", ".join(f"{value:g}" for value in record.setup.background)
            resized = ", resized here" if record.setup.gt_resized else ""
            add("Photographs", f"{record.setup.image_folder}{resized}; background {background}")
            add("Cameras", record.setup.camera_convention)
        if record.quality is not None:
            add("Test views", str(len(record.quality.images)))
        add("Measured with", f"msb {record.tool_version}")
    return [(name, "; ".join(values)) for name, values in found.items()]


def _plain(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _known(numbers: Numbers) -> set[tuple[str, ...]]:
    return {key[:4] for key in numbers.values}


def _metric(metric: str, value: float | None) -> Cell:
    if value is None:
        return Cell(NOT_THERE, reason="nothing to divide by")
    return Cell(text(metric, value), printed_value(metric, value), metric)


def _by_the_driver(found: Memory) -> Cell:
    if found.driver_bytes is None:
        return Cell(NOT_THERE, reason=found.driver_reason or "not measured")
    return _bytes(found.driver_bytes)


def _bytes(count: int) -> Cell:
    return Cell(text("memory", count), count / _MIB, "memory", "MiB")
