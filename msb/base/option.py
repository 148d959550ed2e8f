"""Marks that turn the fields of an options object into options of a command.

Write ``tier: Annotated[Tier, Option("How to draw.")] = "standard"``. A command that takes the object has an
option for each such field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Option:
    """The help of an option, and what the name and the type of its field do not show.

    Attributes
    ----------
    help : str
        What the option does, in one or two sentences.
    flags : tuple of str
        Its spellings. The default follows the name of the field: ``--image-folder``.
    metavar : str, optional
        The word for its value in the help.
    least, most : float, optional
        The range of a number.
    count : bool
        Whether its value is the number of times that it is given.
    output : "file", "own" or "folder", optional
        Set if the path is written. "file": the kit checks that it is new, or that ``--force`` is given.
        "own": the command checks it. "folder": the command checks the files in it; the folder itself can be
        an input.
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
    """The same for an argument, which has no flag. Its name is `metavar`."""
