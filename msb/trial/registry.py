"""The table of tasks, and the selection of tasks and libraries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from msb.base.extras import is_installed, need_extra
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.trial.task import Attempt, Task

# The modules of `msb.trial.tasks`, in the order of the printed results. Each module of tasks has a tuple
# `TASKS`.
_MODULES = ("uv", "decimate", "subdivide", "boolean", "collision", "solid", "self_intersections")

# Name -> task.
TASKS: dict[str, Task] = {
    task.name: task for name in _MODULES for task in import_module(f"msb.trial.tasks.{name}").TASKS
}


def select_tasks(names: Iterable[str] | str) -> list[Task]:
    """Return the tasks with these names. By default, return all tasks.

    The first or last word of a name selects all tasks with that word. For example, "decimate" selects
    "decimate_50". An entry of `names` may contain several names, separated by commas.
    """
    selected: dict[str, Task] = {}
    if not isinstance(names, Iterable):
        raise UsageError("USAGE", f"tasks is {shorten(repr(names), 40)}; pass names of tasks")
    groups = [names] if isinstance(names, str) else names
    for name in (word.strip() for group in groups for word in f"{group}".split(",")):
        matching = {key: task for key, task in TASKS.items() if key == name or _has_word(key, name)}
        if not matching:
            text = f'unknown task "{shorten(name, 40)}"; use one of {", ".join(TASKS)}'
            raise UsageError("USAGE", text)
        selected |= matching
    return [task for key, task in TASKS.items() if key in selected] if selected else list(TASKS.values())


def select_installed(attempts: Iterable[Attempt]) -> list[Attempt]:
    """Return the attempts whose libraries are installed."""
    return [attempt for attempt in attempts if all(map(is_installed, attempt.modules))]


def check_libraries(tasks: Sequence[Task]) -> None:
    """Raise EXTRA_MISSING if a task lacks its libraries and no library of the extra is installed."""
    libraries = {task.name: {entry.library for entry in select_installed(task.attempts)} for task in tasks}
    without_the_extra = {"numpy"}
    if all(libraries.values()) or set().union(*libraries.values()) - without_the_extra:
        return
    possible = [name for name, installed in libraries.items() if installed]
    instead = f"{' and '.join(possible)} can be tried without this extra" if possible else ""
    what = f"trying {', '.join(name for name in libraries if name not in possible)}"
    need_extra("trial", *missing_modules(tasks), what=what, instead=instead)


def missing_modules(tasks: Iterable[Task]) -> list[str]:
    """Return the modules that these tasks need and that are not installed."""
    needed = dict.fromkeys(name for task in tasks for entry in task.attempts for name in entry.modules)
    return [name for name in needed if not is_installed(name)]


def _has_word(name: str, word: str) -> bool:
    return name.startswith(f"{word}_") or name.endswith(f"_{word}")
