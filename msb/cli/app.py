"""The command tree. A command's module is imported when the command is typed, or its help is asked for."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from msb.cli.command import Command, Context, epilog

GROUPS: dict[str, dict[str, str]] = {
    "Look at a mesh": {
        "audit": "Count a mesh's faults and say what it can be used for.",
        "view": "See those faults, in a window, a picture or a page.",
        "trial": "Try on it what artists do: unwrap, decimate, collide, print.",
        "repair": "Make it manifold without changing its look.",
        "info": "Show what an asset or a mesh file holds.",
        "validate": "List everything that is wrong with a file.",
    },
    "Take a model out": {
        "export": "Turn a trained checkpoint into an asset, without PyTorch.",
        "convert": "Write an asset or mesh in another format.",
        "bake": "Make a plain mesh that looks like the model, and say what it lost.",
        "why": "Say why an export looks worse than the render, in dB.",
        "methods": "Say what each method has and what each tier keeps of it.",
    },
    "Draw": {
        "render": "Draw images, depths and face ids.",
        "compare": "See a model's looks side by side with its photographs.",
        "web": "Write a page that shows a model in any browser.",
        "bench": "Measure how fast an asset is drawn, and its memory.",
    },
    "Benchmark": {
        "scenes": "Check scenes: what is there, what counts, what is missing.",
        "run": "Evaluate methods on scenes under one protocol.",
        "eval": "Compare images with photographs: PSNR, SSIM, LPIPS.",
        "submit": "Make of results one file to be published.",
        "report": "Make tables, charts and verdicts from results.",
        "track": "Record time and memory of a training.",
        "demo-data": "Write small scenes and models to try.",
    },
    "Machine": {
        "devices": "Say what can compute and draw on this machine.",
        "completion": "Print what completes commands at the Tab key.",
        "config": "Show which defaults files and variables set.",
    },
}
"""Heading of the list of commands -> command -> what it does. A command that is not here does not exist."""
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
# Plain help text: loads in a third of the time of the framed one, and reads the same in a pipe. Completion is
# what `msb completion` prints; the library's own two options for it would be a second way.
_PLAIN: dict[str, Any] = {
    "rich_markup_mode": None,
    "context_settings": _SETTINGS,
    "add_completion": False,
    "pretty_exceptions_enable": False,
}


class _Group(TyperGroup):
    """A group whose help breaks no word."""

    context_class = Context


class _Root(_Group):
    """The list of commands, under the headings of `GROUPS`; each is made at its first use."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: None for entries in GROUPS.values() for name in entries}  # type: ignore[misc]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, or None if there is none of this name."""
        if self.commands.get(cmd_name, self) is None:
            self.commands[cmd_name] = _made(cmd_name)
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each heading."""
        del ctx
        for title, entries in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(list(entries.items()), col_max=12)


def _made(name: str) -> Any:
    """Return a command of the command-line library."""
    module = import_module(f"msb.cli.{name.replace('-', '_')}")
    if name != "config":
        return get_command(single(module, name))
    group = typer.Typer(name="config", cls=_Group, help=module.HELP, epilog=module.show.epilog, **_PLAIN)
    group.callback(invoke_without_command=True)(_help_alone)
    _add(group, module.show)
    return get_command(group)


def single(module: ModuleType, name: str) -> typer.Typer:
    """Return the command of a module, by itself."""
    app = typer.Typer(**_PLAIN)
    _add(app, next(each for each in vars(module).values() if getattr(each, "name", "") == name))
    return app


def _add(app: typer.Typer, function: Any) -> None:
    settings = _SETTINGS | function.settings
    app.command(function.name, cls=Command, epilog=function.epilog, context_settings=settings)(function)


def _help_alone(context: typer.Context) -> None:
    """Print the help of a group whose command is not given."""
    if context.invoked_subcommand is None:
        from msb.cli.output import echo

        echo(context.get_help())


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


app = typer.Typer(
    name="msb",
    cls=_Root,
    epilog=epilog("msb audit data_stubs/splat_like.triasset", "msb audit --help"),
    **_PLAIN,
)


@app.callback(invoke_without_command=True)
def _root(context: typer.Context, version: Version = False) -> None:
    """Decide whether a trained triangle or mesh splatting model is a usable graphics asset."""
    _help_alone(context)
