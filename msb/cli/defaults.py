"""Defaults of options: a flag counts first, then the environment, the project file, the user file."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.files import is_file, read_file
from msb.errors import InputError, UsageError, shorten

if TYPE_CHECKING:
    Commands = Mapping[str, Any]
    """Name -> command of the command-line library."""

FILE = "msb.toml"
PYPROJECT = "pyproject.toml"
PREFIX = "MSB_"
_OURS = re.compile(rb"""(?<![\w-])["']?msb["']?\s*[]=.]""")
_MAX_BYTES = 1 << 20
_PATHS = {"FILE", "FOLDER", "DIR"}
_NEVER = {"help", "version", "debug", "explain", "force"}
_WORDS = {
    "1": True,
    "true": True,
    "yes": True,
    "on": True,
    "0": False,
    "false": False,
    "no": False,
    "off": False,
}
_DEVICE_VARIABLES = ("MSB_DEVICE", "PYOPENCL_CTX")


@dataclass(frozen=True)
class Default:
    """A value, as the command-line library takes it, and the file or variable it comes from."""

    value: Any
    source: str


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
    text = _read(path)
    if not _OURS.search(text):  # most often not, and then nothing is parsed
        return False
    from msb.base.bounded_parsing import parse_toml

    try:
        tool = parse_toml(text.decode()).get("tool")
    except ValueError:
        return b"tool.msb" in text  # then it is said what is wrong
    return "msb" in tool if isinstance(tool, dict) else tool is not None


def anything_set() -> bool:
    """Return whether there is a file or variable to read. Mostly there is none; then nothing is loaded."""
    variables = any(name.startswith(PREFIX) for name in os.environ)
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
    found: Defaults = {name: {} for name in commands}
    for path in (user_file(), project_file()):
        if path is not None and is_file(path):
            _add_file(found, commands, path)
    if any(os.environ.get(name) for name in _DEVICE_VARIABLES):
        for defaults in found.values():
            defaults.pop("device", None)
    for name, command in commands.items():
        for key, option in options(command):
            upper = key.upper().replace("-", "_")
            own = f"{PREFIX}{name.upper()}_{upper}"
            for variable in (f"{PREFIX}{upper}", own):
                text = os.environ.get(variable)
                if text and key not in _NEVER - {"force"} and variable not in _DEVICE_VARIABLES:
                    found[name][option.name] = Default(_from_text(variable, option, text), variable)
    return found


def options(command: Any) -> Iterator[tuple[str, Any]]:
    """Yield the long name without its dashes, and the parameter, of every option of `command`."""
    for option in command.params:
        for flag in option.opts:
            if option.param_type_name == "option" and flag.startswith("--"):
                yield flag[2:], option


def in_files(key: str, option: Any) -> bool:
    """Return whether a file may set the option: it may not name files, nor allow to replace one."""
    return key not in _NEVER and not _PATHS & set((option.metavar or "").split("|"))


def _add_file(found: Defaults, commands: Commands, path: Path) -> None:
    from msb.base.bounded_parsing import parse_toml

    try:
        data: Any = parse_toml(_read(path).decode())
    except ValueError as error:
        raise UsageError("CONFIG_INVALID", f"it is no TOML: {shorten(str(error))}", file=path) from error
    for keys in ("tool", "tool.msb") if path.name == PYPROJECT else ():
        data = data.get(keys.rpartition(".")[2], {})
        if not isinstance(data, dict):
            raise UsageError("CONFIG_INVALID", f'"{keys}" is {_shown(data)}; it must be a table', file=path)
    # What is said for one command is stronger than what is said for all.
    for name, value in sorted(data.items(), key=lambda item: isinstance(item[1], dict)):
        if isinstance(value, dict):
            if name not in commands:
                raise _unknown(path, name, commands, "command")
            for key, item in value.items():
                _add(found, {name: commands[name]}, key, item, path, f"{name}.{key}")
        else:
            _add(found, commands, name, value, path, name)


def _add(found: Defaults, commands: Commands, key: str, value: Any, path: Path, shown: str) -> None:
    known: dict[str, None] = {}
    used = False
    for name, command in commands.items():
        for flag, option in options(command):
            known |= {flag: None} if in_files(flag, option) else {}
            if flag == key and in_files(flag, option):
                used = True
                found[name][option.name] = Default(_from_toml(path, shown, option, value), str(path))
    if not used:
        raise _unknown(path, shown, known, "option")


def _unknown(path: Path, name: str, known: Mapping[str, Any], what: str) -> UsageError:
    import difflib

    near = difflib.get_close_matches(name.rpartition(".")[2], known, 3, 0.65)
    hint = f"did you mean {' or '.join(near)}?" if near else "msb config show --all lists all"
    text = f'"{shorten(name, 60)}" is no {what} that a file can set; {hint}'
    return UsageError("CONFIG_INVALID", text, file=path)


def _from_toml(path: Path, key: str, option: Any, value: Any) -> Any:
    """Return `value` as if it were typed: a list if the option may be given again, a bool if it is a flag."""
    if option.count:
        right, wanted = _is_scalar(value) and type(value) is int, "a whole number"
    elif option.is_flag:
        right, wanted = isinstance(value, bool), "true or false"
    elif option.multiple:
        right, wanted = isinstance(value, list) and all(map(_is_scalar, value)), "a list of texts or numbers"
    else:
        right, wanted = _is_scalar(value), "a text or number"
    if not right:
        text = f'"{shorten(key)}" is {_shown(value)}; it must be {wanted}'
        raise UsageError("CONFIG_INVALID", text, file=path)
    if option.count or option.is_flag:
        return value
    return [str(item) for item in value] if option.multiple else str(value)


def _is_scalar(value: Any) -> bool:
    if type(value) is int:  # the parser takes more than TOML's 64 bits, and Python may not print them
        return value.bit_length() < 64
    return isinstance(value, str | float)


def _shown(value: Any) -> str:
    try:
        return shorten(repr(value), 40)
    except ValueError:
        return "too long to be shown"


def _from_text(variable: str, option: Any, text: str) -> Any:
    """Return the value of a variable: 1 or 0 for flags, words as a shell splits them for lists."""
    if option.is_flag and not option.count:
        if text.lower() not in _WORDS:
            wanted = ", ".join(_WORDS)
            raise UsageError(
                "CONFIG_INVALID", f'{variable} is "{shorten(text, 40)}"; it must be one of {wanted}'
            )
        return _WORDS[text.lower()]
    if option.multiple:
        try:
            return shlex.split(text)
        except ValueError as error:
            raise UsageError("CONFIG_INVALID", f"{variable}: {error}") from error
    return text


def _read(path: Path) -> bytes:
    try:
        data = read_file(path, _MAX_BYTES)
    except InputError as error:
        raise UsageError("CONFIG_INVALID", error.message, file=path) from error
    if len(data) > _MAX_BYTES:
        raise UsageError("CONFIG_INVALID", f"it has more than {_MAX_BYTES} bytes", file=path)
    return data
