"""The declaration of a task: the libraries to try, and the functions that judge their results."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from numpy.typing import NDArray

from msb.base.children import Arrays
from msb.trial.mesh import TrialMesh
from msb.trial.renderings import Renderings

# The outcome "care" means that the task works with limitations. The outcome "not_run" means that a library or
# images are missing.
Outcome = Literal["works", "care", "fails", "not_run"]
# The outcomes of a task that ran, best first.
OUTCOMES: tuple[Outcome, ...] = ("works", "care", "fails")
Numbers = dict[str, Any]


@dataclass
class Output:
    """The output of a library: numbers as JSON data, meshes to render and save, and further arrays.

    Float arrays (n, 3) are points.
    """

    numbers: Numbers = field(default_factory=dict)
    meshes: dict[str, TrialMesh] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)


# The outputs of a task, by the name of the library.
Outputs = Mapping[str, Output]


@dataclass(frozen=True)
class Attempt:
    """A library and the function that uses it. The function runs in a child process.

    Attributes
    ----------
    library, modules : str, tuple of str
        The distribution name for reporting the version, and the modules that must be installed.
    work : callable
        A function with two arguments, the mesh and the arrays from `Task.prepare`. If the function raises an
        exception, the attempt fails for this reason.
    any_unit : bool
        True if the result does not depend on the unit of length. The function then gets the mesh as stored.
        Otherwise, the function's inputs and outputs are in the unit of `msb.trial.attempts`.
    """

    library: str
    modules: tuple[str, ...]
    work: Callable[[TrialMesh, Arrays], Output]
    any_unit: bool = False


@dataclass(frozen=True)
class AttemptResult:
    """The result of an attempt: its output, or the reason of its failure.

    The field `ended_by` is the reason why the process was stopped, or None. The field `seconds` is the time
    of the library, or None if the library did not run.
    """

    output: Output | None
    why: str = ""
    ended_by: Literal["time", "memory", "crash"] | None = None
    seconds: float | None = None
    version: str | None = None


@dataclass(frozen=True)
class Judgement:
    """The outcome of a task, the reason for a limitation or failure, and the measured numbers."""

    outcome: Outcome
    why: str | None = None
    numbers: Numbers = field(default_factory=dict)

    @property
    def rank(self) -> int:
        """The rank of the outcome. The best outcome has the rank 0."""
        return OUTCOMES.index(self.outcome)


@dataclass(frozen=True)
class Task:
    """A task that artists do with meshes.

    Attributes
    ----------
    name, title : str
        The name in JSON and on the command line, and the title in tables and pages.
    attempts, fallbacks : tuple of Attempt
        The libraries to try first, and the fallback libraries that are tried if all first libraries fail.
        Each attempt returns at most one mesh.
    judge : callable
        A function that judges the outputs. The arguments of the function are the mesh, the outputs by
        library, and the renderings. The function is called only if there is an output. If all attempts fail,
        the task fails. If there are several outputs, the number "best" names the best library.
    summarize : callable
        A function that turns the numbers into a short text for a table.
    powers : mapping of str to int
        The dimension of numbers that have a unit: length (1), area (2) or volume (3).
    prepare : callable, optional
        A function that makes arrays for the attempts, for example from the renderings.
    picture : callable, optional
        A function that draws the outputs as an image (H, W, 3) uint8, or returns None.
    needs_images : bool
        Whether the judgement needs renderings. Without renderings, the outcome is "not_run" or "fails".
    """

    name: str
    title: str
    attempts: tuple[Attempt, ...]
    judge: Callable[[TrialMesh, Outputs, Renderings], Judgement]
    summarize: Callable[[Numbers], str]
    powers: Mapping[str, int] = field(default_factory=dict)
    fallbacks: tuple[Attempt, ...] = ()
    prepare: Callable[[TrialMesh, Renderings], dict[str, NDArray[Any]]] | None = None
    picture: Callable[[TrialMesh, Outputs, Renderings], NDArray[Any] | None] | None = None
    needs_images: bool = False


def file_outcome(original: TrialMesh, result: TrialMesh) -> Outcome:
    """Return "care" if the verdict is BAD or worse than the verdict on the original. Otherwise return
    "works"."""
    levels = ("ok", "limited", "bad")
    is_worse = levels.index(result.verdict.level) > levels.index(original.verdict.level)
    return "care" if is_worse or result.verdict.level == "bad" else "works"


def format_count(number: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun, such as "1 face" or "1,200 faces"."""
    return f"{number:,} {singular if number == 1 else plural or f'{singular}s'}"


def combine(numbers: Numbers, *grades: tuple[Outcome, str]) -> Judgement:
    """Return the worst of several outcomes. The reasons of all outcomes except "works" are added."""
    reasons = [reason for outcome, reason in grades if outcome != "works"]
    return Judgement(pick_worst(outcome for outcome, _ in grades), "; ".join(reasons) or None, numbers)


def pick_worst(outcomes: Iterable[Outcome]) -> Outcome:
    """Return the worst of several outcomes."""
    return max(outcomes, key=OUTCOMES.index)


def grade(value: float | None, works: float, care: float) -> Outcome:
    """Return the outcome for a value that should be small.

    The value gives "works" up to the limit `works`, and "care" up to the limit `care`. The value None counts
    as "works".
    """
    if value is None or value <= works:
        return "works"
    return "care" if value <= care else "fails"
