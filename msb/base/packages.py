"""Parts that other packages bring: found by their entry points, and kept from ending a command."""

import contextlib
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from typing import Any, TypeVar

from msb.errors import MsbError, shorten

# The pattern of the name of a method or a metric, in files and in the entry-point groups.
NAME = r"^[a-z][a-z0-9_]{0,63}$"
Part = TypeVar("Part")


class PackageWarning(UserWarning):
    """A warning that a part of another package cannot be used; all others can."""


class PackageError(Exception):
    """What is wrong with a package, in words that follow its name."""


def installed(
    kind: str, ours: Mapping[str, str], accept: Callable[[str, str], Part], *, pattern: str | None = NAME
) -> dict[str, tuple[Part, str]]:
    """Return the parts that installed packages bring; each part that cannot be used is one warning.

    Parameters
    ----------
    kind : str
        The singular of the entry-point group: "method" reads the group `msb.methods`.
    ours : mapping
        Name -> place of the built-in parts, which no package replaces.
    accept : callable
        Takes the name and the value of an entry and returns its part; it may raise `PackageError`.
    pattern : str, optional
        The regular expression that names must match; None allows all names.

    Returns
    -------
    dict
        Name -> part and value of the entry, sorted by name.
    """
    parts: dict[str, tuple[Part, str]] = {}
    for entry in sorted(_entries(kind), key=lambda entry: (entry.name, entry.value)):
        first = ours.get(entry.name) or parts.get(entry.name, (None, None))[1]
        if first == entry.value:
            continue  # one installation, seen twice
        try:
            if entry.name in ours:
                raise PackageError(f"the name is taken by {first}, which is part of msb")
            if pattern is not None and not re.match(pattern, entry.name):
                raise PackageError(f"its name must match {pattern}")
            if first is not None:
                text = f"the name is taken by {first}, the first in the alphabet; uninstall one of them"
                raise PackageError(text)
            parts[entry.name] = accept(entry.name, entry.value), entry.value
        except PackageError as error:
            where = whose(kind, entry.name, entry.value or getattr(entry.dist, "name", ""))
            warn(f"PACKAGE_LEFT_OUT: {where} is left out: {error}")
    return parts


def _entries(kind: str) -> Iterable[EntryPoint]:
    group = f"msb.{kind}s"
    try:
        return entry_points(group=group)
    except Exception:  # a file of one package that is no entry_points.txt must not hide those of all others
        return [entry for package in distributions() for entry in _own_entries(package, kind, group)]


def _own_entries(package: Distribution, kind: str, group: str) -> Iterator[EntryPoint]:
    try:
        yield from package.entry_points.select(group=group)
    except Exception as error:
        with contextlib.suppress(Exception):
            if f"[{group}]" in (package.read_text("entry_points.txt") or ""):
                text = f"{kind}s of package {package.name} are left out: its entry_points.txt cannot be read"
                warn(f"PACKAGE_LEFT_OUT: {text}: {shorten(str(error), 200)}")


def whose(kind: str, name: str, value: str) -> str:
    """Return what an entry point names as messages have it: "method facets of package msb_facets"."""
    return f"{kind} {shorten(name, 40)} of package {shorten(value.partition(':')[0].strip(), 80)}"


def warn(text: str) -> None:
    """Warn of a package; `text` begins with a code."""
    warnings.warn(text, PackageWarning, stacklevel=2)


def load(value: str) -> Any:
    """Return the object that an entry point's value, "module" or "module:attribute", names."""
    module, _, attribute = (part.strip() for part in value.partition(":"))
    if not module:
        raise PackageError("its entry point names no module")
    try:
        with contained():
            found: Any = import_module(module)
            for part in filter(None, attribute.split(".")):
                found = getattr(found, part)
    except (PackageError, MsbError) as error:
        raise PackageError(f"it cannot be loaded: {error}") from error
    return found


class Lazy(Mapping[str, Part]):
    """A mapping that is made when it is looked into: until then nothing of a package is imported.

    Parameters
    ----------
    make : callable
        A function of a module, which keeps what it made.
    """

    def __init__(self, make: Callable[[], Mapping[str, Part]]) -> None:
        self._make = make

    def __getitem__(self, name: str) -> Part:
        return self._make()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make())

    def __len__(self) -> int:
        return len(self._make())


@contextlib.contextmanager
def contained() -> Iterator[None]:
    """Run code of another package: its exceptions and exits become a `PackageError`.

    Errors of msb pass unchanged. What the code prints goes to standard error, as standard output may hold
    the result of a command.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except (MsbError, PackageError):
        raise
    except (Exception, SystemExit) as error:
        text = f"{type(error).__name__}: {shorten(str(error), 200)}"
        raise PackageError(text.removesuffix(": ")) from error
