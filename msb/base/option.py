"""What a command line says of a field of an options object, which itself knows no command line.

Write ``tier: Annotated[Tier, Option("How to draw.")] = "standard"``. A command that takes the object has an
option for each of its fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Option:
    """The help of an option, and what else its field's name and type do not tell.

    Attributes
    ----------
    help : str
        What the option does, one or two sentences.
    flags : tuple of str
        How it is typed; by default as the field is called: ``--image-folder``.
    metavar : str, optional
        What stands for its value in the help.
    least, most : float, optional
        The range of a number.
    count : bool
        Whether its value is how often it is typed.
    output : "file", "own" or "folder", optional
        Whether it names something that is written: a file, which may not be there without ``--force``;
        something at which the command itself looks; or a folder for files, which may be an input as well.
    endings : tuple of str
        How the name of a file that is written must end.
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
    """The same of what is typed without a name, which its `metavar` shows."""
