"""Options that several commands share, written once."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand
from typer.models import ArgumentInfo

from msb.cli.help_pages import Context
from msb.errors import UsageError

WRITTEN = "written"
"""A mark beside a path's typer.Option: the command writes an output there. Other paths are read, or
filled."""
JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write JSON to FILE; - is standard output, and nothing else."
    ),
    WRITTEN,
]
JsonLines = Annotated[
    Path | None,
    typer.Option("--jsonl", metavar="FILE", help="Write one line of JSON per input to FILE; - as above."),
    WRITTEN,
]
CsvFile = Annotated[
    Path | None,
    typer.Option("--csv", metavar="FILE", help="Write one row per item to FILE; - is standard output."),
    WRITTEN,
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
    WRITTEN,
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
_EVERYWHERE: dict[str, tuple[Any, Any]] = {
    "color": (ColorWhen, None),
    "log_file": (LogFile, None),
    "debug": (Debug, False),
}
"""Options of every command. A command with an option of that name (msb convert --color) keeps its own."""


class Command(TyperCommand):
    """A command of ours: it refuses what the library takes in silence, before anything is opened or read.

    These are an option of one value that is given twice, of which the last would count; and an empty path,
    which would be the current folder.
    """

    context_class = Context

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and refuse repeated options and empty paths."""
        if not ctx.resilient_parsing:  # at the Tab key nothing is complete
            values, _, order = self.make_parser(ctx).parse_args(args=list(args))
            param: Any
            for param in self.params:
                many = param.param_type_name == "argument" or param.multiple or param.count or param.is_flag
                if not many and order.count(param) > 1:
                    ctx.fail(f"{_label(param)} is given {order.count(param)} times; it takes one value")
                given: Any = values.get(param.name)
                if param.name in _paths(self) and "" in (given if _is_many(given) else [given]):
                    ctx.fail(f"{_label(param)} is empty, which names no file; . is the current folder")
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing and not hasattr(self.callback, "declared"):
            self._check_apart(ctx)
        return rest

    def _check_apart(self, ctx: Any) -> None:
        outputs = [param for param in self.params if _paths(self).get(param.name or "")]
        if any(ctx.params.get(param.name) is not None for param in outputs):
            from msb.cli.output import check_apart

            named = [
                (_label(param), Path(path), param in outputs)
                for param in self.params
                if param.name in _paths(self) and (value := ctx.params.get(param.name)) is not None
                for path in (value if _is_many(value) else [value])
            ]
            check_apart(named)

    def get_help(self, ctx: Any) -> str:
        """Return the help page, in which {mesh_suffixes} stands for those of the formats there are."""
        if "{mesh_suffixes}" in (self.help or ""):
            from msb.meshes import MESH_SUFFIXES

            self.help = str(self.help).replace("{mesh_suffixes}", ", ".join(MESH_SUFFIXES))
        return super().get_help(ctx)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage: arguments that may be left out in brackets."""
        arguments: list[Any] = [
            param for param in self.get_params(ctx) if param.param_type_name == "argument"
        ]
        words = [(param, str(param.metavar)) for param in arguments]
        return ["[OPTIONS]", *(word if param.required else f"[{word}]" for param, word in words)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, which are hidden from the library, and the library's list of options."""
        arguments: list[Any] = [
            param for param in self.get_params(ctx) if param.param_type_name == "argument"
        ]
        if arguments:
            with formatter.section("Arguments"):
                formatter.write_dl([(param.metavar, param.help) for param in arguments])
        super().format_options(ctx, formatter)


def refuse(given: Mapping[str, object], why: str) -> None:
    """Refuse options that would be ignored, by their names without dashes."""
    for name, value in given.items():
        if value is not None:
            raise UsageError("USAGE", f"--{name} {why}")


def is_given(context: typer.Context, name: str) -> bool:
    """Return whether the option `name` is on the command line, and not a default or set by a file."""
    return getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"


def alone(context: typer.Context, name: str) -> None:
    """Refuse whatever else is given beside the option `name`, but how to print and log."""
    harmless = {name, "quiet", "verbose", *_EVERYWHERE}
    for param in context.command.params:
        if param.name not in harmless and is_given(context, param.name or ""):
            text = f"{_label(param)} does not go with --{name.replace('_', '-')}, which stands alone"
            raise UsageError("USAGE", text)


def _paths(command: TyperCommand) -> dict[str, bool]:
    """Return the parameters that name a file or folder, as `with_shared` found them, and which is written."""
    return getattr(command.callback, "paths", {})


def _is_many(value: Any) -> bool:
    return isinstance(value, list | tuple)


def _label(param: Any) -> str:
    """Return the name of a parameter in its command's help."""
    if param.param_type_name == "argument":
        return str(param.metavar or param.name).rstrip(".")
    return next((flag for flag in param.opts if flag.startswith("--")), str(param.opts[0]))


def _names_a_path(annotation: Any) -> bool:
    """Return whether a parameter takes a path: by its type, or a text by its metavar (DIR|reference)."""
    if "Path" in re.findall(r"\w+", str(getattr(annotation, "__origin__", annotation))):
        return True
    words = {
        word
        for declared in getattr(annotation, "__metadata__", ())
        for word in re.findall(r"\w+", getattr(declared, "metavar", None) or "")
    }
    return not words.isdisjoint({"PATH", "FILE", "FOLDER", "DIR"})


def with_shared(command: Callable[..., None]) -> Callable[..., None]:
    """Return `command` with the options of all commands added to its signature, where they are read.

    Its attribute `paths` has the name of each parameter that is a path, and whether it is `WRITTEN`.
    """
    own = inspect.signature(command, eval_str=True)
    for parameter in own.parameters.values():
        for declared in getattr(parameter.annotation, "__metadata__", ()):
            if declared is not WRITTEN:
                declared.hidden = isinstance(declared, ArgumentInfo)
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

    parameters = [*own.parameters.values(), *added]
    run.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.paths = {  # type: ignore[attr-defined]
        each.name: WRITTEN in getattr(each.annotation, "__metadata__", ())
        for each in parameters
        if _names_a_path(each.annotation)
    }
    return run


def _color(when: str | None) -> None:
    """Set the variables of colour: what prints, such as rich and our child processes, reads them."""
    for name, wish in (("FORCE_COLOR", "always"), ("NO_COLOR", "never")):
        if when is not None:
            os.environ.pop(name, None)
        if when == wish:
            os.environ[name] = "1"


def print_version() -> None:
    """Print the versions of what computes."""
    from importlib.metadata import PackageNotFoundError, version

    from msb.asset.manifest import FORMAT, VERSION
    from msb.base.version import __version__
    from msb.cli.output import echo

    parts = [f"{FORMAT} {VERSION}"]
    for package in ("numpy", "pyopencl"):
        try:
            parts.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            parts.append(f"{package} none")
    echo(f"msb {__version__} ({', '.join(parts)})")


def _version(wanted: bool) -> None:
    if wanted:
        print_version()
        raise typer.Exit


Version = Annotated[
    bool, typer.Option("--version", callback=_version, is_eager=True, help="Print versions and stop.")
]
_EXIT_TABLE = (
    "Exit status: 0 done, 1 a gate or validation failed, 2 wrong usage, 3 input\n"
    "missing or not valid, 4 not supported, 5 no OpenCL device, 130 interrupted."
)

_DEMO_DATA = "The examples' files are there after: msb demo-data data_stubs"


def epilog(*examples: str) -> str:
    """Return the end of a help page: examples as they are, the exit statuses, and where data is from."""
    lines = "\n".join(f"  {example}" for example in examples)
    data = f"\n\n{_DEMO_DATA}" if "data_stubs" in lines else ""
    return f"\b\nExamples:\n{lines}\n\n\b\n{_EXIT_TABLE}{data}"
