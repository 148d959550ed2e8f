"""Defaults of options: a flag counts first, then the environment, the project file, the user file."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msb.base.files import is_file, read_file
from msb.errors import InputError, UsageError, shorten

FILE = "msb.toml"
PYPROJECT = "pyproject.toml"
_MAX_BYTES = 1 << 20
_DEVICE_VARIABLES = ("MSB_DEVICE", "PYOPENCL_CTX")
"""What `msb.cl` reads itself, and says which it was."""


@dataclass(frozen=True)
class Default:
    """A value, as the command-line library takes it, and the file or variable it comes from."""

    value: Any
    source: str


Commands = Mapping[str, Any]
"""Name -> command of the command-line library."""
Defaults = dict[str, dict[str, Default]]
"""Command -> parameter -> its default."""


def user_file() -> Path:
    """Return where the user's own file would be."""
    import typer

    return Path(typer.get_app_dir("msb")) / FILE


def project_file() -> Path | None:
    """Return the nearest msb.toml, or pyproject.toml with [tool.msb], in this folder or one above it."""
    try:
        here = Path.cwd()
    except OSError:  # the folder was removed
        return None
    for folder in (here, *here.parents):
        if is_file(folder / FILE):
            return folder / FILE
        if is_file(folder / PYPROJECT) and _has_our_table(folder / PYPROJECT):
            return folder / PYPROJECT
    return None


def _has_our_table(path: Path) -> bool:
    """Return whether a pyproject.toml has the key tool.msb, in whatever way it is written, or tries to."""
    data = _read(path)
    if b"msb" not in data:  # most often not, and then nothing is parsed
        return False
    from msb.base.bounded_parsing import parse_toml

    try:
        tool = parse_toml(data.decode()).get("tool")
    except ValueError:
        return b"tool.msb" in data  # then it is said what is wrong
    return "msb" in tool if isinstance(tool, dict) else tool is not None


def anything_set() -> bool:
    """Return whether there is a file or variable to read. Mostly there is none; then nothing is loaded."""
    variables = any(name.startswith("MSB_") for name in os.environ)
    return variables or project_file() is not None or is_file(user_file())


def single_commands(group: Any) -> Commands:
    """Return the commands of `group` that are not groups themselves."""
    commands = {name: group.get_command(None, name) for name in group.commands}
    return {name: each for name, each in commands.items() if not hasattr(each, "commands")}


def read_defaults(commands: Commands) -> Defaults:
    """Return the defaults that files and environment set for `commands`; the stronger source counts.

    A key of a file is an option without its dashes. At the top it holds for every command that has the
    option; in a table it holds for the command of the table's name. The variable is ``MSB_COMMAND_OPTION``
    or, for every command, ``MSB_OPTION``. MSB_DEVICE and PYOPENCL_CTX, which `msb.cl` reads, count as
    variables.
    """
    defaults: Defaults = {name: {} for name in commands}
    for path in (user_file(), project_file()):
        if path is not None and is_file(path):
            _add_file(defaults, commands, path)
    if any(os.environ.get(name) for name in _DEVICE_VARIABLES):
        for of_command in defaults.values():
            of_command.pop("device", None)
    for name, command in commands.items():
        for key, option in options(command):
            for variable in (f"msb_{key}", f"msb_{name}_{key}"):
                variable = variable.upper().replace("-", "_")
                text = os.environ.get(variable)
                if text and variable not in _DEVICE_VARIABLES:
                    defaults[name][option.name] = Default(_from_text(variable, option, text), variable)
    return defaults


def options(command: Any) -> Iterator[tuple[str, Any]]:
    """Yield the long name without its dashes, and the parameter, of every option that need not be typed."""
    declared = command.callback.declared
    for option in command.params:
        if not declared[option.name].option.only_typed:
            for flag in option.opts:
                if option.param_type_name == "option" and flag.startswith("--"):
                    yield flag[2:], option


def in_files(command: Any, option: Any) -> bool:
    """Return whether a file may set the option: it may name no files, nor allow to replace one."""
    return option.name != "force" and not command.callback.declared[option.name].is_path


def _add_file(defaults: Defaults, commands: Commands, path: Path) -> None:
    from msb.base.bounded_parsing import parse_toml

    try:
        data: Any = parse_toml(_read(path).decode())
    except ValueError as error:
        raise UsageError("CONFIG_INVALID", f"it is no TOML: {shorten(str(error))}", file=path) from error
    for keys in ("tool", "tool.msb") if path.name == PYPROJECT else ():
        data = data.get(keys.rpartition(".")[2], {})
        if not isinstance(data, dict):
            raise UsageError("CONFIG_INVALID", f'"{keys}" is {_shown(data)}; it must be a table', file=path)
    # A command's table overrides the top level.
    for name, value in sorted(data.items(), key=lambda item: isinstance(item[1], dict)):
        if not isinstance(value, dict):
            _add(defaults, commands, name, value, path, name)
        elif name not in commands:
            raise _unknown(path, name, commands, "command")
        else:
            for key, item in value.items():
                _add(defaults, {name: commands[name]}, key, item, path, f"{name}.{key}")


def _add(defaults: Defaults, commands: Commands, key: str, value: Any, path: Path, shown: str) -> None:
    known = {
        (name, flag): option
        for name, command in commands.items()
        for flag, option in options(command)
        if in_files(command, option)
    }
    wanted = {name: option for (name, flag), option in known.items() if flag == key}
    if not wanted:
        every = {flag for command in commands.values() for option in command.params for flag in option.opts}
        raise _unknown(path, shown, {} if f"--{key}" in every else dict.fromkeys(flag for _, flag in known))
    given = {name: _from_toml(path, shown, option, value) for name, option in wanted.items()}
    wrong = [_refusal(name, commands[name], option, given[name]) for name, option in wanted.items()]
    if all(wrong):  # at the top level it may be for some of the commands only
        raise UsageError("CONFIG_INVALID", f'"{shorten(shown)}": {wrong[0]}', file=path)
    for name, option in wanted.items():
        defaults[name][option.name] = Default(given[name], str(path))


def _refusal(name: str, command: Any, option: Any, value: Any) -> str | None:
    """Return why the command-line library refuses a value, as it would if it were typed; else None."""
    from msb.cli.command import plain_words

    context = command.context_class(command, info_name=name)
    try:
        option.process_value(context, value)
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        return plain_words(str(getattr(error, "message", error)), error)
    return None


def _unknown(path: Path, name: str, known: Mapping[str, Any], what: str = "option") -> UsageError:
    """Return the error about a name that is none of those `known`; without any it is only for typing."""
    import difflib

    near = difflib.get_close_matches(name.rpartition(".")[2], known, 3, 0.65)
    hint = f"did you mean {' or '.join(near)}?" if near else "msb config show --all lists all"
    hint = hint if known else "it has to be typed, lest a project from elsewhere sets it"
    text = f'"{shorten(name, 60)}" is no {what} that a file can set; {hint}'
    return UsageError("CONFIG_INVALID", text, file=path)


def _is_scalar(value: Any) -> bool:
    if type(value) is int:  # the parser takes more than TOML's 64 bits, and Python may not print them
        return value.bit_length() < 64
    return isinstance(value, str | float)


_KINDS: tuple[tuple[str, str, Callable[[Any], bool], Callable[[Any], Any]], ...] = (
    ("count", "a whole number", lambda value: type(value) is int and _is_scalar(value), int),
    ("is_flag", "true or false", lambda value: isinstance(value, bool), bool),
    (
        "multiple",
        "a list of texts or numbers",
        lambda value: isinstance(value, list) and all(map(_is_scalar, value)),
        lambda value: [*map(str, value)],
    ),
    ("name", "a text or number", _is_scalar, str),
)
"""An attribute that options of a kind have, their value in a file, whether it is one, and as it is typed."""


def _from_toml(path: Path, key: str, option: Any, value: Any) -> Any:
    _, wanted, is_right, typed = next(kind for kind in _KINDS if getattr(option, kind[0]))
    if not is_right(value):
        text = f'"{shorten(key)}" is {_shown(value)}; it must be {wanted}'
        raise UsageError("CONFIG_INVALID", text, file=path)
    return typed(value)


def _shown(value: Any) -> str:
    try:
        return shorten(repr(value), 40)
    except ValueError:
        return "too long to be shown"


def _from_text(variable: str, option: Any, text: str) -> str | list[str]:
    """Return the value of a variable as it is typed; a list is split as a shell splits words."""
    if not option.multiple:
        return text
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UsageError("CONFIG_INVALID", f"{variable}: {error}") from error


def _read(path: Path) -> bytes:
    try:
        data = read_file(path, _MAX_BYTES)
    except InputError as error:
        raise UsageError("CONFIG_INVALID", error.message, file=path) from error
    if len(data) > _MAX_BYTES:
        raise UsageError("CONFIG_INVALID", f"it has more than {_MAX_BYTES} bytes", file=path)
    return data
