"""What a task is: what is asked of which libraries, each in its own child, and how the answers are judged."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh

Outcome = Literal["works", "care", "fails", "not_run"]
# The outcomes of a task that was run, best first.
OUTCOMES: tuple[Outcome, ...] = ("works", "care", "fails")
Numbers = dict[str, Any]


@dataclass
class Made:
    """What an attempt leaves: numbers as JSON has them, meshes to draw and keep, and further arrays.

    Arrays (n, 3) of floating numbers are points.
    """

    numbers: Numbers = field(default_factory=dict)
    meshes: dict[str, TriedMesh] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Attempt:
    """One library's way to do a task. It runs in a child process (`msb.trial.attempts`).

    Attributes
    ----------
    library, modules : str, tuple of str
        The distribution, whose version is reported, and what has to be installed for it.
    work : callable
        A function of the mesh and the arrays that `Task.prepare` made. What it raises is reported as the
        library's words.
    any_unit : bool
        Whether it is handed the mesh as stored, because no coordinate reaches a library: else it gets, and
        makes, meshes and points in the unit of `msb.trial.attempts`.
    """

    library: str
    modules: tuple[str, ...]
    work: Callable[[TriedMesh, Arrays], Made]
    any_unit: bool = False


@dataclass(frozen=True)
class Attempted:
    """What became of an attempt: what it made, or why there is nothing, in the library's words or ours.

    `ended_by` says what ended it, where it did not end by itself; `seconds` is the time that the library
    took, None where it did not run.
    """

    made: Made | None
    why: str = ""
    ended_by: Literal["time", "memory", "crash"] | None = None
    seconds: float | None = None
    version: str | None = None


@dataclass(frozen=True)
class Judgement:
    """What a task came to: the outcome, why it is not better, and the numbers."""

    outcome: Outcome
    why: str | None = None
    numbers: Numbers = field(default_factory=dict)


@dataclass(frozen=True)
class Task:
    """A thing that is done with meshes, and how it is tried.

    Attributes
    ----------
    name, title : str
        The name in JSON and on the command line, and what tables and pages print.
    attempts, instead : tuple of Attempt
        What is tried, which makes one mesh each, if any; what is tried where none of these gives anything.
    judge : callable
        A function of the mesh, library -> what it made, and the pictures. It sees successes only, of one
        library or several; where there is none, the task has failed. Of several its number "best" names the
        library that counts.
    says : callable
        A function of the numbers to a short text for a table.
    powers : mapping of str to int
        Names of the attempts' numbers that are lengths (1), areas (2) or volumes (3).
    prepare : callable, optional
        Makes arrays for the attempts from the pictures.
    picture : callable, optional
        Draws what was made, as an image (H, W, 3) uint8, or None if there is nothing to draw.
    by_look : bool
        Whether it is judged by pictures: without any there is no judgement, unless it fails.
    """

    name: str
    title: str
    attempts: tuple[Attempt, ...]
    judge: Callable[[TriedMesh, Mapping[str, Made], Look], Judgement]
    says: Callable[[Numbers], str]
    powers: Mapping[str, int] = field(default_factory=dict)
    instead: tuple[Attempt, ...] = ()
    prepare: Callable[[TriedMesh, Look], dict[str, NDArray[Any]]] | None = None
    picture: Callable[[TriedMesh, Mapping[str, Made], Look], NDArray[Any] | None] | None = None
    by_look: bool = False


def file_outcome(given: TriedMesh, made: TriedMesh) -> Outcome:
    """Return what a task can come to at best: "care" where a file is BAD, or worse than what was tried."""
    levels = ("ok", "limited", "bad")
    worse = levels.index(made.verdict.level) > levels.index(given.verdict.level)
    return "care" if worse or made.verdict.level == "bad" else "works"


def counted(number: int, one: str, many: str | None = None) -> str:
    """Return "1 face" or "1,200 faces"."""
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def judged(numbers: Numbers, *graded: tuple[Outcome, str]) -> Judgement:
    """Return the worst of several outcomes, and the reasons of all that are not "works"."""
    reasons = [reason for outcome, reason in graded if outcome != "works"]
    return Judgement(worst(outcome for outcome, _ in graded), "; ".join(reasons) or None, numbers)


def worst(outcomes: Iterable[Outcome]) -> Outcome:
    """Return the worst outcome of several conditions."""
    return max(outcomes, key=OUTCOMES.index)


def graded(value: float | None, works: float, care: float) -> Outcome:
    """Return the outcome of a value that should be small: at most `works`, at most `care`, or more.

    A value that there is not does not count against a task.
    """
    if value is None or value <= works:
        return "works"
    return "care" if value <= care else "fails"
