"""`msb devices`: what OpenCL can compute on here, which renderers can draw, and what could be added."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msb.cli.options import DeviceName, Force, JsonFile, Quiet, Verbose, epilog
from msb.cli.output import Output, plain_table
from msb.errors import DeviceError, MsbError

if TYPE_CHECKING:
    from msb.cl import DeviceRecord
    from msb.cl.devices import Choice

EPILOG = epilog("msb devices", "msb devices -v --device cpu", "msb devices --json -")
SCHEMA = "msb.devices/1"
_BYTES = ("global_memory", "max_allocation", "local_memory")


def devices(
    device: DeviceName = None,
    json_file: JsonFile = None,
    force: Force = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """List the OpenCL devices, what to type to get each, which one is taken; and the renderers there are.

    -v shows every limit and ability. docs/opencl.md tells how to get more devices, docs/engines.md how to
    get the renderers that are missing.
    """
    from msb.cl import list_devices
    from msb.cl.devices import choose_device
    from msb.cl.loader import notes

    output = Output(json_file, quiet, verbose, force)
    output.check_free(json_file)
    records, choice, problem = list_devices(), None, None
    try:
        choice = choose_device(device)
    except MsbError as error:
        problem = error
    if not records:
        raise problem or DeviceError("DEVICE_NOT_FOUND", "the devices went away while they were listed")
    hints = [*notes(), *_missing(records)]
    renderers = _renderers()
    output.write_json(
        {
            "schema": SCHEMA,
            "devices": [record.to_dict() for record in records],
            "chosen": choice and choice.record.selector,
            "chosen_by": choice and choice.source,
            "notes": hints,
            "renderers": renderers,
        }
    )
    if output.prints_text:
        _print(records, choice, hints, output)
        _print_renderers(renderers, output)
    if problem:
        raise problem


def _print(records: list[DeviceRecord], choice: Choice | None, hints: list[str], output: Output) -> None:
    console = output.console()
    table = plain_table("--device", "Platform", "Device", "Kind", "Units", "Memory", "Driver", right=(4, 5))
    for record in records:
        mark = " *" if choice and record.selector == choice.record.selector else ""
        memory = f"{record.global_memory / 2**30:.1f} GiB"
        cells = (record.platform, record.name, record.kind, str(record.compute_units), memory, record.driver)
        table.add_row(record.selector + mark, *cells)
    console.print(table, markup=False)
    if choice:
        console.print(f"\n* {_why(choice)}", markup=False)
    if output.verbose:
        for record in records:
            console.print(_details(record))
    if not output.quiet:
        for hint in hints:
            console.print(f"- {hint}", markup=False)


def _renderers() -> list[dict[str, Any]]:
    """Return every renderer: its name, where it is, and what is missing before it can draw."""
    from msb.render.protocol import renderers, what_is_missing

    return [
        {"name": name, "from": where, "missing": what_is_missing(name)} for name, where in renderers().items()
    ]


def _print_renderers(renderers: list[dict[str, Any]], output: Output) -> None:
    console = output.console()
    table = plain_table("\n--renderer", "\nCan draw")
    for renderer in renderers:
        missing = renderer["missing"]
        cell = "yes" if missing is None else missing if not output.quiet else "no"
        table.add_row(renderer["name"], cell)
    console.print(table, markup=False)


def _why(choice: Choice) -> str:
    if choice.source == "default":
        return "is taken unless --device, MSB_DEVICE or PYOPENCL_CTX names another: CPUs first, PoCL first."
    source = "--device" if choice.source == "argument" else choice.source
    return f"is taken because of {source} {choice.selector}"


def _details(record: DeviceRecord) -> Any:
    from rich.markup import escape

    table = plain_table(f"\n{record.selector}", "")
    for key, value in record.to_dict().items():
        if key != "selector":
            text = f"{value:,} bytes" if key in _BYTES else str(value)
            table.add_row(key.replace("_", " "), escape(text))
    return table


def _missing(records: list[DeviceRecord]) -> list[str]:
    """Return what could be added to this machine, a sentence each."""
    import platform
    import sys

    has = {record.selector.partition(":")[0] for record in records}
    found = []
    if "pocl" not in has:
        from msb.cl.loader import how_to_get_pocl

        found.append(f"No PoCL, the platform results are compared on: {how_to_get_pocl()}.")
    if "intel" not in has and sys.platform == "linux" and platform.machine() == "x86_64":
        found.append("A faster CPU platform, on AMD too: pip install 'meshsplatbench[intel]'.")
    if not any(record.kind == "gpu" for record in records):
        found.append("No GPU: one appears when its driver brings OpenCL (an .icd file).")
    return found
