"""Options that several commands share, written once."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write JSON to FILE; - is standard output, and nothing else."
    ),
]
JsonLines = Annotated[
    Path | None,
    typer.Option("--jsonl", metavar="FILE", help="Write one line of JSON per input to FILE; - as above."),
]
CsvFile = Annotated[
    Path | None,
    typer.Option("--csv", metavar="FILE", help="Write one row per item to FILE; - is standard output."),
]
FailFast = Annotated[bool, typer.Option("--fail-fast", help="Stop at the first input that fails.")]
Force = Annotated[bool, typer.Option("--force", "-f", help="Replace outputs that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say less: no progress, no notes, short results.")]
Verbose = Annotated[
    int, typer.Option("--verbose", "-v", count=True, help="Say more; twice: also each step and its time.")
]
DeviceName = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="cpu|gpu|PLATFORM:INDEX",
        help="The OpenCL device, as msb devices lists them. Default: MSB_DEVICE, PYOPENCL_CTX, or PoCL. "
        "Foreign engines: cpu or gpu.",
    ),
]
ColorWhen = Annotated[
    Literal["auto", "always", "never"] | None,
    typer.Option("--color", help="Colour the output: on terminals (auto), always or never."),
]
LogFile = Annotated[
    Path | None,
    typer.Option("--log-file", metavar="FILE", help="Append notes, errors, steps and their times to FILE."),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
_EVERYWHERE: dict[str, tuple[Any, Any]] = {
    "color": (ColorWhen, None),
    "log_file": (LogFile, None),
    "debug": (Debug, False),
}
"""Options every command has. A command with one of that name, as --color of msb convert, keeps its own."""


def with_shared(command: Callable[..., None]) -> Callable[..., None]:
    """Return `command` with the options of all commands added to its signature, where they are read."""
    own = inspect.signature(command, eval_str=True)
    for parameter in own.parameters.values():
        for declared in getattr(parameter.annotation, "__metadata__", ()):
            # A file that may not be read is for its reader to report, with its code and status.
            declared.readable = False
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, (annotation, default) in _EVERYWHERE.items()
        if name not in own.parameters
    ]

    @functools.wraps(command)
    def run(**values: Any) -> None:
        given = {parameter.name: values.pop(parameter.name) for parameter in added}
        _color(given.get("color"))
        if given["log_file"] is not None:
            from msb.cli.output import open_log

            open_log(given["log_file"])
        command(**values)

    run.__signature__ = own.replace(parameters=[*own.parameters.values(), *added])  # type: ignore[attr-defined]
    return run


def _color(when: str | None) -> None:
    """Say it as the environment does: what prints, rich and processes we start, reads it there."""
    for name, wish in (("FORCE_COLOR", "always"), ("NO_COLOR", "never")):
        if when is not None:
            os.environ.pop(name, None)
        if when == wish:
            os.environ[name] = "1"


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    from importlib.metadata import PackageNotFoundError, version

    from msb._version import __version__
    from msb.asset.manifest import FORMAT, VERSION
    from msb.cli.output import echo

    parts = [f"{FORMAT} {VERSION}"]
    for package in ("numpy", "pyopencl"):
        try:
            parts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            parts.append(f"{package} none")
    echo(f"msb {__version__} ({', '.join(parts)})")
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
