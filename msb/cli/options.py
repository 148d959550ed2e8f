"""Options that several commands share, written once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write JSON to FILE; - is standard output, and nothing else."
    ),
]
Force = Annotated[bool, typer.Option("--force", "-f", help="Replace outputs that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say less: no progress, no notes, short results.")]
Verbose = Annotated[int, typer.Option("--verbose", "-v", count=True, help="Say more; twice for even more.")]
DeviceName = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="cpu|gpu|PLATFORM:INDEX",
        help="The OpenCL device, as msb devices lists them. Default: MSB_DEVICE, PYOPENCL_CTX, or PoCL.",
    ),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    from importlib.metadata import PackageNotFoundError, version

    from msb._version import __version__
    from msb.asset.manifest import FORMAT, VERSION

    parts = [f"{FORMAT} {VERSION}"]
    for package in ("numpy", "pyopencl"):
        try:
            parts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            parts.append(f"{package} none")
    typer.echo(f"msb {__version__} ({', '.join(parts)})")
    raise typer.Exit


Version = Annotated[
    bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print versions and stop.")
]
_EXIT_TABLE = (
    "Exit status: 0 done, 1 a gate or validation failed, 2 wrong usage, 3 input\n"
    "missing or not valid, 4 not supported, 5 no OpenCL device, 130 interrupted."
)


def epilog(*examples: str) -> str:
    """Return the end of a help page: examples, kept as they are, and the exit statuses."""
    lines = "\n".join(f"  {example}" for example in examples)
    return f"\b\nExamples:\n{lines}\n\n\b\n{_EXIT_TABLE}"
