"""`msb devices`: the OpenCL devices and renderers of this machine, and hints at missing ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from msb.cli.command import command
from msb.cli.output import JsonOutput, Output
from msb.errors import DeviceError, MsbError
from msb.render.options import RendererOptions

if TYPE_CHECKING:
    from msb.cl.devices import Choice, Tried

_BYTES = ("global_memory", "max_allocation", "local_memory")


@command("msb devices", "msb devices -v --device cpu", "msb devices --json -")
def devices(drawing: Annotated[RendererOptions, ("device",)], output: JsonOutput) -> None:
    """List the OpenCL devices and the renderers of this machine, with their problems.

    Every device is tested again. -v shows all limits and capabilities, and the workarounds that a device
    needed. docs/opencl.md explains how to get more devices, and docs/engines.md explains how to install
    missing renderers.
    """
    from msb.cl.devices import choose_device, try_devices
    from msb.cl.loader import notes

    with output.progress("building a kernel on each device"):
        tried = try_devices()
    choice, problem = None, None
    try:
        choice = choose_device(drawing.device)
    except MsbError as error:
        problem = error
    if not tried:
        raise problem or DeviceError("DEVICE_NOT_FOUND", "devices disappeared while they were listed")
    hints = [*notes(), *_explain_failures(tried), *_suggest_platforms(tried)]
    renderers = _list_renderers(choice)
    output.write_json(
        {
            "schema": "msb.devices/1",
            "devices": [
                {**device.record.to_dict(), **asdict(device.trial), "advice": device.advice}
                for device in tried
            ],
            "chosen": choice and choice.record.selector,
            "chosen_by": choice and choice.source,
            "notes": hints,
            "renderers": renderers,
        }
    )
    if output.prints_text:
        _print(tried, choice, hints, output)
        rows = [
            (item["name"], "yes" if item["missing"] is None else "no" if output.quiet else item["missing"])
            for item in renderers
        ]
        output.table(("\n--renderer", "\nCan draw"), rows)
    if problem:
        raise problem


def _print(tried: list[Tried], choice: Choice | None, hints: list[str], output: Output) -> None:
    names = ("--device", "Kind", "Units", "Memory", "Driver", "Builds", "Device")
    rows = []
    for record, trial, _ in tried:
        mark = " *" if choice and record.selector == choice.record.selector else ""
        memory = f"{record.global_memory / 2**30:.1f} GiB"
        builds = ("fixed" if trial.mended else "yes") if trial.builds else "NO"
        cells = (record.kind, str(record.compute_units), memory, record.driver, builds)
        rows.append((record.selector + mark, *cells, f"{record.name}, {record.platform}"))
    output.table(names, rows, right=(2, 3))
    console = output.console()
    if choice:
        console.print(f"\n* {_explain_choice(choice)}", markup=False)
    if output.verbose:
        for device in tried:
            output.table((f"\n{device.record.selector}", ""), _list_details(device))
    if not output.quiet:
        for hint in hints:
            console.print(f"- {hint}", markup=False)


def _list_renderers(choice: Choice | None) -> list[dict[str, Any]]:
    """Return the name, the module and the problem of every renderer.

    The problem is None if the renderer can draw on this machine.
    """
    from msb.render.backend import ON_OPENCL, renderers, why_unavailable

    without = None if choice else "no OpenCL device on this machine builds kernels"
    return [
        {
            "name": name,
            "from": where,
            "missing": why_unavailable(name) or (without if name in ON_OPENCL else None),
        }
        for name, where in renderers().items()
    ]


def _explain_choice(choice: Choice) -> str:
    if choice.source == "default":
        return "default device (PoCL and CPUs first); --device, MSB_DEVICE or PYOPENCL_CTX selects another"
    source = "--device" if choice.source == "argument" else choice.source
    return f"selected by {source} {choice.selector}"


def _list_details(device: Tried) -> Iterator[tuple[str, str]]:
    from msb.cl.pocl_fix import FIX_VARIABLE

    record, trial, _ = device
    builds = "yes" if trial.builds else f"no: {trial.why}"
    if trial.mended:
        builds += (
            ", with a workaround: its compiler does not know this processor and compiles for "
            f"{trial.mended} instead (docs/opencl.md; {FIX_VARIABLE}=0 disables this workaround)"
        )
    yield "builds kernels", builds
    for key, value in record.to_dict().items():
        if key != "selector":
            yield key.replace("_", " "), f"{value:,} bytes" if key in _BYTES else str(value)


def _explain_failures(tried: list[Tried]) -> list[str]:
    """Return the reason and the remedy for each device that does not build kernels."""
    return [
        f"{record.selector} does not build kernels: {trial.why}. {advice}."
        for record, trial, advice in tried
        if not trial.builds
    ]


def _suggest_platforms(tried: list[Tried]) -> list[str]:
    """Return hints about platforms that can be added to this machine, one sentence each."""
    from msb.cl.loader import how_to_get_pocl

    hints = []
    if not any(record.selector.startswith("pocl:") for record, _, _ in tried):
        hints.append(f"PoCL, the reference platform of results, is not installed: {how_to_get_pocl()}.")
    if not any(record.kind == "gpu" for record, _, _ in tried):
        hints.append("No GPU found. Install a GPU driver that includes OpenCL (an .icd file).")
    return hints
