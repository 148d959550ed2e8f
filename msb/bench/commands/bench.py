"""`msb bench`: measure frame rate, device time and memory of an asset on a tier."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from msb.base.option import Option
from msb.bench.timing import Timing
from msb.cli.command import Typed, command
from msb.cli.output import JsonOutput, Output
from msb.errors import GateFailed, InputError, UsageError, shorten
from msb.render.options import NO_CAMERAS, RendererOptions, Source, Tier, ViewOptions

SCHEMA = "msb.bench/1"
# Number of views around the asset when --cameras is not given.
_VIEWS = 8
# Keys whose values are compared between two records. The command prints a note on each difference.
_SAME = (
    "method", "faces", "tier", "renderer", "order", "sampling", "views", "sizes", "machine.device.name",
    "machine.device.driver",
)  # fmt: skip


@dataclass(frozen=True)
class BenchOptions:
    """Options for the tier to time, and for an earlier record to compare with."""

    tier: Annotated[Tier, Option("The renderer tier to time; msb methods describes the tiers.")] = "standard"
    compare: Annotated[
        Path | None, Option("Compare with an earlier record written by --json.", metavar="OLD.json")
    ] = None
    fail_slower: Annotated[
        str | None,
        Option(
            "With --compare: fail if the median device time exceeds the time in OLD.json by more than "
            "PERCENT, for example 10%.",
            metavar="PERCENT",
        ),
    ] = None

    @property
    def limit(self) -> float | None:
        """The limit of --fail-slower as a fraction, such as 0.1 for "10%" or "10"."""
        if self.fail_slower is None:
            return None
        match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?)\s*%?", self.fail_slower.strip())
        if match is None:
            text = f'--fail-slower is "{shorten(self.fail_slower, 40)}", but it must have the form 10%'
            raise UsageError("USAGE", text)
        return float(match[1]) / 100


@command(
    "msb bench data_stubs/splat_like.triasset",
    "msb bench --repeat 20 --seconds 0.5 --json out/a.json data_stubs/checkpoint",
    "msb bench --cameras data_stubs/views.json --scale 0.5 data_stubs/checkpoint",
)
def bench(
    path: Source,
    options: BenchOptions,
    views: Annotated[ViewOptions, ("cameras", "camera", "size", "background")],
    timing: Timing,
    drawing: Annotated[RendererOptions, ("assignments", "order", "sampling", "renderer", "device")],
    output: JsonOutput,
    typed: Typed,
) -> None:
    """Measure how fast an asset is rendered, and how much memory the renderer needs.

    The output lists frames per second, the median (P50) and the 95th percentile (P95) of the device time, the
    stages of the renderer, and its memory. Images are neither written nor read back during the timing. The
    reported memory covers all views, including views that the timing does not reach. Without --cameras, eight
    views around the asset are used.
    """
    if views.cameras is None:
        typed.reject(["camera"], NO_CAMERAS)
    if options.compare is None:
        typed.reject(["fail_slower"], "needs --compare OLD.json")
    from msb.api.command_files import open_asset
    from msb.bench.nvml import read_driver_memory
    from msb.bench.profile import profile
    from msb.render import Renderer
    from msb.render.backend import ON_OPENCL, minimal_options
    from msb.render.machine import machine
    from msb.scenes.around import make_turntable

    limit = options.limit
    old = None if options.compare is None else _read_old(options.compare)
    asset = open_asset(path, output)
    if views.cameras is not None:
        cameras = views.read(output.note)
    else:
        cameras = make_turntable(asset, _VIEWS, *views.pixels(960, 720))
    color = views.color(asset)
    lean = minimal_options(options.tier, drawing.renderer) | drawing.modes
    settings = drawing.settings(asset)
    with Renderer(asset, options.tier, drawing.device, settings, name=drawing.renderer, **lean) as renderer:
        with output.counted("timing", timing.frames) as step:
            timed = profile(renderer, cameras, color, **asdict(timing), step=step)
        # A renderer of another package that measures device times is assumed to use OpenCL.
        ours = (drawing.renderer or options.tier) in ON_OPENCL
        opencl = ours or (drawing.renderer is not None and timed.timing.has_device_times)
        about = machine(drawing.device, opencl=opencl, engine=renderer.device_info)
        driver, reason = read_driver_memory(about.get("device", {}))
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "path": str(path),
        "method": asset.manifest.method,
        "faces": asset.manifest.face_count,
        "tier": options.tier,
        "renderer": renderer.name,
        **drawing.modes,
        "views": len(cameras),
        "sizes": sorted({f"{view.width}x{view.height}" for view in cameras}),
        "machine": about,
        **timed.to_dict(),
        "memory_views": len(cameras),
        "driver_memory_bytes": driver,
        "driver_memory_reason": reason,
    }
    if output.prints_text:
        _print(record, old, output)
    output.write_json(record)
    if old is not None:
        for key in _SAME:
            if _get(old, key) != _get(record, key):
                text = (
                    f"{key} was {_get(old, key)} and is now {_get(record, key)}, so times are not comparable"
                )
                output.note(f"{options.compare}: {text}")
        if limit is not None:
            if not timed.timing.has_device_times:
                raise UsageError("USAGE", "--fail-slower: the renderer reports no device times")
            _check_slower(timed.timing.p50_ms, old, limit, path)


def _check_slower(now: float, old: dict[str, Any], limit: float, path: Path) -> None:
    """Raise GATE_FAILED if the growth of the median device time exceeds the fraction `limit`."""
    before = old["device_ms"].get("p50")
    if not before:
        raise UsageError("USAGE", "--fail-slower: OLD.json has no median device time (device_ms.p50)")
    if now > before * (1 + limit):
        text = (
            f"the median device time is {now:.3g} ms, before {before:.3g} ms ({now / before - 1:+.0%}); "
            f"the limit is {limit:+.0%}"
        )
        raise GateFailed("GATE_FAILED", text, file=path)


def _get(record: dict[str, Any], key: str) -> Any:
    """Return the value at a dotted key such as "machine.device.name", or None."""
    value: Any = record
    for name in key.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _read_old(path: Path) -> dict[str, Any]:
    """Read an earlier record of `msb bench --json`."""
    from msb.asset.strict_json import MAX_BYTES, parse_strict_json
    from msb.base.files import read_file

    about: dict[str, Any] = {"name": "the record", "error": InputError, "code": "FILE_NOT_RECOGNISED"}
    data = parse_strict_json(read_file(path, MAX_BYTES), file=path, **about)
    if not isinstance(data, dict) or data.get("schema") != SCHEMA or not _is_record(data):
        text = f"the file is not a record of msb bench --json (schema {SCHEMA})"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path)
    return data


def _is_record(data: dict[str, Any]) -> bool:
    """Return whether the tables of a record contain only numbers and nulls."""
    tables = [data.get(key) for key in ("device_ms", "busy_ms", "stages_ms", "memory_bytes")]
    values = [value for table in tables if isinstance(table, dict) for value in table.values()]
    numbers = (*values, data.get("driver_memory_bytes"))
    # Device times are null if the renderer measures none.
    return (
        all(isinstance(table, dict) for table in tables)
        and type(data.get("fps")) in (int, float)
        and all(type(value) in (int, float, type(None)) for value in numbers)
    )


def _print(record: dict[str, Any], old: dict[str, Any] | None, output: Output) -> None:
    """Print the record as a table, with a column for an older record."""
    device = record["machine"].get("device")
    modes = [f"{name} {record[name]}, " for name in ("order", "sampling") if name in record]
    output.line(
        f"{record['path']}: {record['faces']:,} faces, tier {record['tier']}, {''.join(modes)}"
        f"{record['views']} views of {', '.join(record['sizes'])}, {record['frames']} frames"
    )
    where = f" on {device['platform']}: {device['name']}" if device else ", no device"
    output.line(f"{record['renderer']}{where}")
    rows = []
    for label, unit, get in _list_rows(record, output.verbose > 0):
        value = get(record)
        cells = [label, _format_number(value, unit)]
        if old:
            before = get(old)
            both = value is not None and before
            cells += [_format_number(before, unit), f"{value / before:.2f}" if both else "-"]
        rows.append(cells)
    headers = ("", "Now", "Before", "Now / before") if old else ("", "Now")
    output.table(headers, rows[:3] if output.quiet else rows, right=range(1, len(headers)))


def _list_rows(record: dict[str, Any], everything: bool) -> Iterator[tuple[str, str, Any]]:
    """Yield the table rows: label, unit, and a function that reads the value from a record.

    If `everything` is false, buffers with less than 1 % of the memory are left out.
    """
    yield "frames per second", "", lambda data: data["fps"]
    yield "device time, median (P50)", "ms", lambda data: data["device_ms"].get("p50")
    yield "device time, P95", "ms", lambda data: data["device_ms"].get("p95")
    yield "sum of stages, median", "ms", lambda data: data["busy_ms"].get("p50")
    for name in record["stages_ms"]:
        yield f"  {name}", "ms", lambda data, name=name: data["stages_ms"].get(name)
    memory = record["memory_bytes"]
    total = sum(memory.values())
    yield "memory of buffers, all views", "B", lambda data: sum(data["memory_bytes"].values()) or None
    for use, size in sorted(memory.items(), key=lambda item: -item[1]):
        if everything or size >= total / 100:
            yield f"  {use}", "B", lambda data, use=use: data["memory_bytes"].get(use, 0)
    if record["driver_memory_bytes"] is not None:
        yield "GPU memory of the process", "B", lambda data: data.get("driver_memory_bytes")


def _format_number(value: float | None, unit: str) -> str:
    """Return a value with its unit, or "--". Bytes are printed in MiB, and short times in microseconds."""
    if value is None:
        return "--"
    if unit == "B":
        return f"{value / 2**20:,.2f} MiB"
    if unit == "ms":
        return f"{value:,.3f} ms" if value >= 0.1 else f"{1000 * value:.1f} µs"
    return f"{value:,.2f}"
