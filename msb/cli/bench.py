"""`msb bench`: how fast an asset is drawn on a tier, and what it takes in memory."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from msb.cli.camera_options import (
    Assignments,
    Background,
    Cameras,
    Chosen,
    Ordering,
    RendererName,
    SamplingName,
    Scale,
    Size,
    TierName,
)
from msb.cli.options import DeviceName, Force, JsonFile, Quiet, Verbose, epilog
from msb.cli.output import Output, plain_table
from msb.errors import GateFailed, InputError, UsageError, shorten

if TYPE_CHECKING:
    from msb.bench.profile import Profile

EPILOG = epilog(
    "msb bench data_stubs/splat_like.triasset",
    "msb bench --repeat 20 --seconds 0.5 --json out/a.json data_stubs/checkpoint",
    "msb bench --cameras data_stubs/views.json --scale 0.5 data_stubs/checkpoint",
)
SCHEMA = "msb.bench/1"
_TURNTABLE = 8
_SAME = (
    "method", "faces", "tier", "renderer", "order", "sampling", "views", "sizes", "machine.device.name",
    "machine.device.driver",
)  # fmt: skip
"""Keys that must be equal before two records are compared."""


def bench(
    path: Annotated[Path, typer.Argument(metavar="ASSET", help="A .triasset, checkpoint or mesh file.")],
    tier: TierName = "standard",
    cameras: Cameras = None,
    chosen: Chosen = None,
    size: Size = None,
    scale: Scale = None,
    background: Background = None,
    frames: Annotated[
        int, typer.Option("--repeat", min=1, metavar="N", help="Time at least N frames ...")
    ] = 100,
    seconds: Annotated[float, typer.Option(min=0, metavar="S", help="... and at least S seconds.")] = 3.0,
    warm_up: Annotated[
        int | None,
        typer.Option(
            "--warmup", min=0, metavar="N", help="Draw N frames first; default: 10, or for a second."
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option("--budget-seconds", min=0, metavar="S", help="Stop after S seconds in any case."),
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(metavar="OLD.json", help="Show ratios to an earlier --json.")
    ] = None,
    fail_slower: Annotated[
        str | None,
        typer.Option(
            metavar="PERCENT", help="Fail if P50 is more than this above that of OLD.json, e.g. 10%."
        ),
    ] = None,
    assignments: Assignments = None,
    order: Ordering = None,
    sampling: SamplingName = None,
    renderer_name: RendererName = None,
    device: DeviceName = None,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Time how an asset is drawn: P50 and P95 of the device, frames per second, stages, memory.

    Nothing is written and no pixel is read back while the clock runs. The memory is what all views need;
    views that were not timed are drawn afterwards. Without --cameras eight views around the asset are used.
    """
    from msb.asset.settings import parse_overrides
    from msb.bench.machine import machine
    from msb.bench.nvml import driver_memory
    from msb.bench.profile import profile
    from msb.cli.camera_options import around, cameras_at, chosen_modes, parse_background
    from msb.cli.inputs import open_asset
    from msb.render import Renderer
    from msb.render.backend import lean_options

    output = Output(json_file, quiet, verbose, force)
    output.check_free(json_file)
    limit = _limit(fail_slower, compare)
    old = _read_old(compare) if compare is not None else None
    with output.progress(f"reading {path.name}"):
        asset = open_asset(path, output)
    if cameras is not None:
        views = cameras_at(cameras, chosen, size, scale, output)
    elif chosen or scale is not None:
        raise UsageError("USAGE", "--camera and --scale need --cameras")
    else:
        views = around(asset, _TURNTABLE, size, None, 20.0)
    settings = parse_overrides(asset.manifest.method, assignments or [])
    color = parse_background(background, asset)
    modes = chosen_modes(order, sampling)
    options = lean_options(tier, renderer_name) | modes
    with Renderer(asset, tier, device, settings, name=renderer_name, **options) as renderer:
        with output.counted("timing", frames) as step:
            found = profile(
                renderer, views, color, frames=frames, seconds=seconds, warm_up=warm_up,
                budget=math.inf if budget is None else budget, step=step,
            )  # fmt: skip
        name, about = renderer.name, machine(device, engine=renderer.device_info)
        driver, reason = driver_memory(about["device"])
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "path": str(path),
        "method": asset.manifest.method,
        "faces": asset.manifest.face_count,
        "tier": tier,
        "renderer": name,
        **modes,
        "views": len(views),
        "sizes": sorted({f"{view.width}x{view.height}" for view in views}),
        "machine": about,
        **found.to_dict(),
        "driver_memory_bytes": driver,
        "driver_memory_reason": reason,
    }
    output.write_json(record)
    if output.prints_text:
        _print(record, found, old, output)
    if found.frames < frames:
        output.note(f"{path}: {found.frames} of {frames} frames were timed within --budget-seconds")
    if found.memory_views < len(views):
        text = f"its memory is of {found.memory_views} of {len(views)} views"
        output.note(f"{path}: {text}, which were drawn within --budget-seconds")
    if old is not None:
        for key in _SAME:
            if _part(old, key) != _part(record, key):
                text = f"{key} was {_part(old, key)}, is {_part(record, key)}: not the same is compared"
                output.note(f"{compare}: {text}")
        if limit is not None:
            _check_slower(found.p50, old, limit, path)


def _limit(text: str | None, compare: Path | None) -> float | None:
    """Return 0.1 for "10%" or "10"."""
    if text is None:
        return None
    if compare is None:
        raise UsageError("USAGE", "--fail-slower needs --compare OLD.json")
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?)\s*%?", text.strip())
    if match is None:
        raise UsageError("USAGE", f'--fail-slower is "{shorten(text, 40)}"; it must look like 10%')
    return float(match[1]) / 100


def _check_slower(now: float, old: dict[str, Any], limit: float, path: Path) -> None:
    """Raise GateFailed `GATE_FAILED` if the median frame takes longer than it did by more than `limit`."""
    was = old["device_ms"].get("p50")
    if not was:
        raise UsageError("USAGE", "--fail-slower: the older record has no device P50")
    if now > was * (1 + limit):
        text = f"device P50 is {now:.3g} ms, was {was:.3g} ms: {now / was - 1:+.0%}, allowed {limit:+.0%}"
        raise GateFailed("GATE_FAILED", text, file=path)


def _part(record: dict[str, Any], key: str) -> Any:
    """Return the value at a dotted key, or None."""
    value: Any = record
    for name in key.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value


def _read_old(path: Path) -> dict[str, Any]:
    """Return an earlier record."""
    from msb.asset.strict_json import MAX_BYTES, parse_strict_json
    from msb.base.files import read_file

    about: dict[str, Any] = {"name": "the record", "error": InputError, "code": "FILE_NOT_RECOGNISED"}
    data = parse_strict_json(read_file(path, MAX_BYTES), file=path, **about)
    if not isinstance(data, dict) or data.get("schema") != SCHEMA or not _is_record(data):
        text = f"it is no record of msb bench --json (schema {SCHEMA})"
        raise InputError("FILE_NOT_RECOGNISED", text, file=path)
    return data


def _is_record(data: dict[str, Any]) -> bool:
    tables = [data.get(key) for key in ("device_ms", "stages_ms", "memory_bytes")]
    values = [value for table in tables if isinstance(table, dict) for value in table.values()]
    return all(isinstance(table, dict) for table in tables) and all(
        type(value) in (int, float) for value in (*values, data.get("fps"))
    )


def _print(record: dict[str, Any], found: Profile, old: dict[str, Any] | None, output: Output) -> None:
    from rich.markup import escape

    console = output.console()
    about = record["machine"]["device"]
    modes = [f"{name} {record[name]}, " for name in ("order", "sampling") if name in record]
    console.print(
        f"{escape(record['path'])}: {record['faces']:,} faces, tier {record['tier']}, {''.join(modes)}"
        f"{record['views']} views of {', '.join(record['sizes'])}, {found.frames} frames\n"
        f"{escape(record['renderer'])} on {escape(about['platform'])}: {escape(about['name'])}",
        soft_wrap=True,
    )
    rows = list(_rows(found, record["views"], record["driver_memory_bytes"], output.verbose > 0))
    if output.quiet:
        rows = rows[:3]
    headers = ("", "Now", "Before", "Now / before") if old else ("", "Now")
    table = plain_table(*headers, right=(1, 2, 3) if old else (1,))
    for label, unit, value, before in rows:
        cells = [label, _number(value, unit)]
        if old:
            was = before(old)
            cells += [_number(was, unit), f"{value / was:.2f}"] if was else ["-", "-"]
        table.add_row(*cells)
    console.print(table)


def _rows(found: Profile, views: int, driver: int | None, everything: bool) -> Any:
    """Yield label, unit, value, and how to find the value in an older record."""
    yield "frames per second", "", found.fps, lambda old: old["fps"]
    yield "device P50", "ms", found.p50, lambda old: old["device_ms"].get("p50")
    yield "device P95", "ms", found.p95, lambda old: old["device_ms"].get("p95")
    yield "busy P50", "ms", found.busy_p50, lambda old: old.get("busy_ms", {}).get("p50")
    for name, value in found.stages.items():
        yield f"  {name}", "ms", value, lambda old, name=name: old["stages_ms"].get(name)
    total = sum(found.memory.values())
    seen = "all views" if found.memory_views == views else f"{found.memory_views} of {views} views"
    yield f"memory, {seen}", "MiB", total / 2**20, lambda old: sum(old["memory_bytes"].values()) / 2**20
    uses = sorted(found.memory.items(), key=lambda item: -item[1])
    for use, size in uses if everything else [item for item in uses if item[1] >= total / 100]:
        yield f"  {use}", "MiB", size / 2**20, lambda old, use=use: old["memory_bytes"].get(use, 0) / 2**20
    if driver is not None:
        yield "process, by the driver", "MiB", driver / 2**20, lambda old: _bytes(old) / 2**20


def _bytes(old: dict[str, Any]) -> int:
    was = old.get("driver_memory_bytes")
    return was if type(was) is int else 0


def _number(value: float, unit: str) -> str:
    if unit == "ms":
        return f"{value:,.3f} ms" if value >= 0.1 else f"{1000 * value:.1f} µs"
    return f"{value:,.2f} {unit}".rstrip()
