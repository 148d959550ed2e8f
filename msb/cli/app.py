"""The program `msb` with its commands, and programs of a single command."""

from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from msb.cli import commands
from msb.cli.command import Command, epilog
from msb.errors import UsageError

_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
# Plain help text loads three times as fast as help text in frames. Typer's options for completion are off,
# because `msb completion` prints the completion script.
_PLAIN: dict[str, Any] = {
    "rich_markup_mode": None,
    "context_settings": _SETTINGS,
    "add_completion": False,
    "pretty_exceptions_enable": False,
}


class _Root(TyperGroup):
    """The list of commands under headings. A command is imported at its first use."""

    def list_commands(self, ctx: Any) -> list[str]:
        del ctx
        return [name for entries in commands.listed().values() for name in entries]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, or None if no command has this name."""
        if self.commands.get(cmd_name) is None:
            try:
                function = commands.find(cmd_name)
            except UsageError:
                if not ctx.resilient_parsing:
                    raise
                function = None  # completion skips commands that cannot be loaded
            if function is None:
                # Typer searches this dictionary for similar names.
                self.commands.update(dict.fromkeys(self.list_commands(ctx)))  # type: ignore[arg-type]
                return None
            self.commands[cmd_name] = get_command(_alone(function, cmd_name))
        return self.commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section of the help for each heading."""
        del ctx
        for title, entries in commands.listed().items():
            with formatter.section(title):
                formatter.write_dl(list(entries.items()), col_max=12)


def single(name: str) -> typer.Typer:
    """Return the program of a single command."""
    return _alone(commands.find(name), name)


def _alone(function: Any, name: str) -> typer.Typer:
    app = typer.Typer(**_PLAIN)
    settings = _SETTINGS | function.settings
    app.command(name, cls=Command, epilog=function.epilog, context_settings=settings)(function)
    return app


def print_version() -> None:
    """Print the versions of msb, the file format, NumPy and PyOpenCL."""
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


def _version(requested: bool) -> None:
    if requested:
        print_version()
        raise typer.Exit


Version = Annotated[
    bool, typer.Option("--version", callback=_version, is_eager=True, help="Print versions and exit.")
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
    del version  # the callback of --version has already printed the version
    if context.invoked_subcommand is None:
        from msb.cli.output import echo

        echo(context.get_help())
