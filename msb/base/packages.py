"""Find and load plug-ins of other packages, and convert their errors to warnings."""

import contextlib
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from typing import Any, TypeVar

from msb.errors import MsbError, shorten

# Pattern for the names of methods and metrics in files and in entry points.
NAME = r"^[a-z][a-z0-9_]{0,63}$"
Plugin = TypeVar("Plugin")


class PackageWarning(UserWarning):
    """A warning that a plug-in cannot be used. Other plug-ins remain usable."""


class PackageError(Exception):
    """An error of a plug-in. The text of the error is printed after the plug-in's name and a colon."""


def find_installed(
    kind: str, ours: Mapping[str, str], accept: Callable[[str, str], Plugin], *, pattern: str | None = NAME
) -> dict[str, tuple[Plugin, str]]:
    """Return the plug-ins of installed packages. Each unusable plug-in causes one warning.

    Parameters
    ----------
    kind : str
        The entry-point group in the singular: "method" means the group `msb.methods`, and "mesh" means
        `msb.meshes`.
    ours : mapping
        Modules of the built-in parts by name; a plug-in cannot replace them.
    accept : callable
        Takes the name and the value of an entry point and returns the plug-in. The callable may raise
        `PackageError`.
    pattern : str, optional
        Regular expression that names must match; None allows all names.

    Returns
    -------
    dict
        For each name, the plug-in and the value of its entry point, sorted by name.
    """
    plugins: dict[str, tuple[Plugin, str]] = {}
    for entry in sorted(_entries(kind), key=lambda entry: (entry.name, entry.value)):
        first = ours.get(entry.name) or plugins.get(entry.name, (None, None))[1]
        if first == entry.value:
            continue  # the same installation was listed twice
        try:
            if entry.name in ours:
                raise PackageError(f"the name belongs to {first}, which is part of msb")
            if pattern is not None and not re.match(pattern, entry.name):
                raise PackageError(f"the name must match {pattern}")
            if first is not None:
                text = f"{first} has the same name and comes first in the alphabet; uninstall one package"
                raise PackageError(text)
            plugins[entry.name] = accept(entry.name, entry.value), entry.value
        except PackageError as error:
            where = describe_entry(kind, entry.name, entry.value or getattr(entry.dist, "name", ""))
            warn(f"PACKAGE_LEFT_OUT: {where} is ignored: {error}")
    return plugins


def _entries(kind: str) -> Iterable[EntryPoint]:
    group = f"msb.{_plural(kind)}"
    try:
        return entry_points(group=group)
    except Exception:  # invalid entry_points.txt of a package: read all files separately
        return [entry for package in distributions() for entry in _own_entries(package, kind, group)]


def _own_entries(package: Distribution, kind: str, group: str) -> Iterator[EntryPoint]:
    try:
        yield from package.entry_points.select(group=group)
    except Exception as error:
        with contextlib.suppress(Exception):
            if f"[{group}]" in (package.read_text("entry_points.txt") or ""):
                text = f"{_plural(kind)} of package {package.name} are ignored"
                text += ": the file entry_points.txt cannot be read"
                warn(f"PACKAGE_LEFT_OUT: {text}: {shorten(str(error), 200)}")


def _plural(kind: str) -> str:
    return f"{kind}es" if kind.endswith("sh") else f"{kind}s"


def describe_entry(kind: str, name: str, value: str) -> str:
    """Return the name of an entry point for messages, such as "method facets of package msb_facets"."""
    return f"{kind} {shorten(name, 40)} of package {shorten(value.partition(':')[0].strip(), 80)}"


def warn(text: str) -> None:
    """Issue a warning about a plug-in. The `text` begins with an error code."""
    warnings.warn(text, PackageWarning, stacklevel=2)


def load(value: str) -> Any:
    """Import and return the object of an entry point, whose value is "module" or "module:attribute"."""
    module, _, attribute = (part.strip() for part in value.partition(":"))
    if not module:
        raise PackageError("the entry point does not name a module")
    try:
        with contain_errors():
            loaded: Any = import_module(module)
            for part in filter(None, attribute.split(".")):
                loaded = getattr(loaded, part)
    except (PackageError, MsbError) as error:
        raise PackageError(f"the module cannot be loaded: {error}") from error
    return loaded


class Lazy(Mapping[str, Plugin]):
    """A mapping that is created at first use. At first use, the plug-ins are imported.

    Parameters
    ----------
    make : callable
        A function that returns the mapping. The function should cache the mapping, because each access
        calls the function.
    """

    def __init__(self, make: Callable[[], Mapping[str, Plugin]]) -> None:
        self._make = make

    def __getitem__(self, name: str) -> Plugin:
        return self._make()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make())

    def __len__(self) -> int:
        return len(self._make())


@contextlib.contextmanager
def contain_errors() -> Iterator[None]:
    """Run code of another package and turn its exceptions and exits into `PackageError`.

    Errors of msb are raised unchanged. The code's output is printed on standard error, because a command may
    print JSON on standard output.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except (MsbError, PackageError):
        raise
    except (Exception, SystemExit) as error:
        text = f"{type(error).__name__}: {shorten(str(error), 200)}"
        raise PackageError(text.removesuffix(": ")) from error
