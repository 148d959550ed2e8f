"""Annotations that turn the fields of an options dataclass into command-line options.

Example: ``tier: Annotated[Tier, Option("How to draw.")] = "standard"``. A command that takes an options
dataclass has an option for each annotated field.
"""

from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from msb.errors import UsageError, shorten


@dataclass(frozen=True)
class Option:
    """The help of an option, and properties in addition to the name and the type of its field.

    Attributes
    ----------
    help : str
        The effect of the option, in one or two sentences.
    flags : tuple of str
        Names of the option on the command line. Default: the name of the field, such as ``--image-folder``.
    metavar : str, optional
        The word for the option's value in the help.
    least, most : float, optional
        The range of a number.
    count : bool
        Whether the value counts how often the option is given, as in ``-vv``.
    output : "file", "own" or "folder", optional
        The rule for checking an output path. "file" means that `msb.cli` checks that the file is new, or
        that ``--force`` is given. "own" means that the command checks the path. "folder" means that the
        command checks the files in the folder, which can also be an input.
    endings : tuple of str
        Allowed endings of the name of an output file.
    """

    help: str
    flags: tuple[str, ...] = ()
    metavar: str | None = None
    least: float | None = None
    most: float | None = None
    count: bool = False
    output: Literal["file", "own", "folder"] | None = None
    endings: tuple[str, ...] = ()


class Argument(Option):
    """A positional argument with the attributes of an `Option`. `metavar` is the name of the argument."""


def label_of(options: Any, name: str) -> str:
    """Return the name of a field on the command line, such as ``--image-folder``."""
    option = _option(get_type_hints(type(options), include_extras=True)[name])
    return option.flags[0] if option is not None and option.flags else f"--{name.replace('_', '-')}"


def check_values(options: Any) -> None:
    """Check the values of an options object against the choices of a `Literal` and the range of an `Option`.

    Raises
    ------
    UsageError
        USAGE: a value is invalid. The message names the command-line option.
    """
    for name, hint in get_type_hints(type(options), include_extras=True).items():
        value, option = getattr(options, name), _option(hint)
        if option is None or value is None:
            continue
        literals = (kind for kind in _alternatives(hint) if get_origin(kind) is Literal)
        words = [word for kind in literals for word in get_args(kind)]
        if words and value not in words:
            wanted = f"one of {', '.join(words)}"
        elif not _is_in_range(value, option):
            most = "" if option.most is None else f" and at most {option.most:g}"
            wanted = f"a finite number, at least {option.least:g}{most}"
        else:
            continue
        text = f'{label_of(options, name)} is "{shorten(str(value), 40)}"; it must be {wanted}'
        raise UsageError("USAGE", text)


def _option(hint: Any) -> Option | None:
    return next((mark for mark in get_args(hint) if isinstance(mark, Option)), None)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the types of a field ``Annotated[A | B, ...]``: A and B."""
    kind = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _is_in_range(value: Any, option: Option) -> bool:
    if option.least is None:
        return True
    return bool(option.least <= value < float("inf") and (option.most is None or value <= option.most))
