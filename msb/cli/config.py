"""`msb config`: the values that options have if they are not typed, and where these come from."""

from __future__ import annotations

from typing import Annotated, Any

from msb.base.option import Option
from msb.cli.command import command
from msb.cli.output import JsonOutput, echo

HELP = "Show the values that files and the environment give to options."


@command("msb config show", "msb config show --all", "msb config show --json -")
def show(
    *,
    all: Annotated[bool, Option("Show also options that have their default, in every command.")] = False,
    output: JsonOutput,
) -> None:
    """Show what files and the environment set, and where.

    The strongest comes first: the option, the variable MSB_COMMAND_OPTION or MSB_OPTION, msb.toml or
    [tool.msb] in pyproject.toml in this folder or the nearest above, the user's msb.toml, the default.
    docs/cli.md tells more.
    """
    from typer.main import get_command

    from msb.cli import defaults
    from msb.cli.app import app

    commands = defaults.single_commands(get_command(app))
    set_values = defaults.read_defaults(commands)
    rows: list[dict[str, Any]] = []
    for name, each in commands.items():
        for key, option in defaults.options(each):
            default = set_values[name].get(option.name)
            if default is not None:
                rows.append({"key": f"{name}.{key}", "value": default.value, "from": default.source})
            elif all and defaults.in_files(each, option):
                rows.append({"key": f"{name}.{key}", "value": _plain(option.default), "from": "default"})
    project, user = defaults.project_file(), defaults.user_file()
    output.write_json(
        {
            "schema": "msb.config/1",
            "project_file": None if project is None else str(project),
            "user_file": str(user) if user.is_file() else None,
            "settings": rows,
        }
    )
    if not output.prints_text:
        return
    absent = "" if user.is_file() else ", which does not exist"
    echo(f"project file: {project or 'none'}")
    echo(f"user file: {user}{absent}")
    if not rows:
        echo("Nothing is set: every option has its default; --all lists them.")
        return
    output.table(
        ("Option", "Value", "From"), ((row["key"], _text(row["value"]), row["from"]) for row in rows)
    )


def _plain(value: Any) -> Any:
    """Return a default as JSON can hold it."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float) else str(value)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
