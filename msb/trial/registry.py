"""The tasks there are, by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from msb.base.extras import is_installed, need_extra
from msb.errors import UsageError, shorten

if TYPE_CHECKING:
    from msb.trial.task import Attempt, Task

# Modules of `msb.trial.tasks`, each with its `TASKS`, in the order of reports.
_MODULES = ("uv", "decimate", "subdivide", "boolean", "collision", "solid", "self_intersections")

# Name -> task.
TASKS: dict[str, Task] = {
    task.name: task for name in _MODULES for task in import_module(f"msb.trial.tasks.{name}").TASKS
}


def chosen_tasks(names: Iterable[str] | str) -> list[Task]:
    """Return the tasks of these names, all if there are none; a word of a name stands for all that have it.

    Names may also stand between commas.
    """
    chosen: dict[str, Task] = {}
    if not isinstance(names, Iterable):
        raise UsageError("USAGE", f"tasks is {shorten(repr(names), 40)}; it must be names of tasks")
    groups = [names] if isinstance(names, str) else names
    for name in (one.strip() for group in groups for one in f"{group}".split(",")):
        own = {key: task for key, task in TASKS.items() if key == name or _has_word(key, name)}
        if not own:
            text = f'there is no task "{shorten(name, 40)}"; there are {", ".join(TASKS)}'
            raise UsageError("USAGE", text)
        chosen |= own
    return [task for key, task in TASKS.items() if key in chosen] if chosen else list(TASKS.values())


def able(attempts: Iterable[Attempt]) -> list[Attempt]:
    """Return the attempts whose libraries are installed."""
    return [one for one in attempts if all(map(is_installed, one.modules))]


def check_libraries(tasks: Sequence[Task]) -> None:
    """Refuse tasks some of which cannot be tried, where no library of the extra is there for the others."""
    by_task = {task.name: {one.library for one in able(task.attempts)} for task in tasks}
    without_the_extra = {"numpy"}
    if all(by_task.values()) or set().union(*by_task.values()) - without_the_extra:
        return
    rest = [name for name, libraries in by_task.items() if libraries]
    instead = f"{' and '.join(rest)} can be tried without it" if rest else ""
    what = f"trying {', '.join(name for name in by_task if name not in rest)}"
    need_extra("trial", *missing_modules(tasks), what=what, instead=instead)


def missing_modules(tasks: Iterable[Task]) -> list[str]:
    """Return the modules that these tasks need and that are not installed."""
    needed = dict.fromkeys(name for task in tasks for one in task.attempts for name in one.modules)
    return [name for name in needed if not is_installed(name)]


def _has_word(name: str, word: str) -> bool:
    return name.startswith(f"{word}_") or name.endswith(f"_{word}")
