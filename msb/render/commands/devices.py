"""`msb devices`: what OpenCL can compute on here, which renderers can draw, and what could be added."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

from msb.cli.command import command
from msb.cli.output import JsonOutput, Output
from msb.errors import DeviceError, MsbError
from msb.render.options import Drawing

if TYPE_CHECKING:
    from msb.cl.devices import Choice, Tried

_BYTES = ("global_memory", "max_allocation", "local_memory")


@command("msb devices", "msb devices -v --device cpu", "msb devices --json -")
def devices(drawing: Annotated[Drawing, ("device",)], output: JsonOutput) -> None:
    """List the OpenCL devices, whether each builds kernels and which one is used; and the renderers.

    Every device is tried anew. -v shows every limit and ability, and what had to be done to make a device
    work. docs/opencl.md tells how to get more devices, docs/engines.md how to get the renderers that are
    missing.
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
        raise problem or DeviceError("DEVICE_NOT_FOUND", "the devices went away while they were listed")
    hints = [*notes(), *_failures(tried), *_missing(tried)]
    renderers = _renderers(choice)
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
            (each["name"], "yes" if each["missing"] is None else "no" if output.quiet else each["missing"])
            for each in renderers
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
        builds = ("mended" if trial.mended else "yes") if trial.builds else "NO"
        cells = (record.kind, str(record.compute_units), memory, record.driver, builds)
        rows.append((record.selector + mark, *cells, f"{record.name}, {record.platform}"))
    output.table(names, rows, right=(2, 3))
    console = output.console()
    if choice:
        console.print(f"\n* {_why(choice)}", markup=False)
    if output.verbose:
        for device in tried:
            output.table((f"\n{device.record.selector}", ""), _details(device))
    if not output.quiet:
        for hint in hints:
            console.print(f"- {hint}", markup=False)


def _renderers(choice: Choice | None) -> list[dict[str, Any]]:
    """Return every renderer: its name, where it is, and what is missing before it can draw."""
    from msb.render.backend import ON_OPENCL, renderers, what_is_missing

    without = None if choice else "no OpenCL device that builds kernels"
    return [
        {
            "name": name,
            "from": where,
            "missing": what_is_missing(name) or (without if name in ON_OPENCL else None),
        }
        for name, where in renderers().items()
    ]


def _why(choice: Choice) -> str:
    if choice.source == "default":
        return "is taken unless --device, MSB_DEVICE or PYOPENCL_CTX names another: CPUs first, PoCL first."
    source = "--device" if choice.source == "argument" else choice.source
    return f"is taken because of {source} {choice.selector}"


def _details(device: Tried) -> Iterator[tuple[str, str]]:
    from msb.cl.mend import MEND_VARIABLE

    record, trial, _ = device
    builds = "yes" if trial.builds else f"no: {trial.why}"
    if trial.mended:
        builds += (
            f", once its compiler, which knows no processor of this kind, is told that it is a "
            f"{trial.mended} (docs/opencl.md; {MEND_VARIABLE}=0 switches that off)"
        )
    yield "builds kernels", builds
    for key, value in record.to_dict().items():
        if key != "selector":
            yield key.replace("_", " "), f"{value:,} bytes" if key in _BYTES else str(value)


def _failures(tried: list[Tried]) -> list[str]:
    """Return for each device that does not build kernels why that is, and what to do."""
    return [
        f"{record.selector} does not build kernels: {trial.why}. {advice}."
        for record, trial, advice in tried
        if not trial.builds
    ]


def _missing(tried: list[Tried]) -> list[str]:
    """Return what could be added to this machine, one sentence for each."""
    from msb.cl.loader import how_to_get_pocl

    hints = []
    if not any(record.selector.startswith("pocl:") for record, _, _ in tried):
        hints.append(f"No PoCL, the platform results are compared on: {how_to_get_pocl()}.")
    if not any(record.kind == "gpu" for record, _, _ in tried):
        hints.append("No GPU: one appears when its driver brings OpenCL (an .icd file).")
    return hints
