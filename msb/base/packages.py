"""Parts that other packages bring: found by their entry points, and run so that none can end a command.

A command keeps its status and its output, whatever the code of a package does.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from typing import IO, Any, TypeVar

from msb.errors import MsbError, shorten

NAME = r"^[a-z][a-z0-9_]{0,63}$"
"""The pattern of the name of a method or a metric, in files and in the entry-point groups."""
Part = TypeVar("Part")


class PackageWarning(UserWarning):
    """A warning that a part of another package cannot be used; all others can."""


class PackageError(Exception):
    """What is wrong with a package, in words that follow its name."""


def installed(
    kind: str, ours: Mapping[str, str], accept: Callable[[str, str], Part]
) -> dict[str, tuple[Part, str]]:
    """Return what the packages in the entry-point group of a kind bring; what cannot be used is one warning.

    Parameters
    ----------
    kind : {"method", "renderer", "metric"}
        The group is its plural, such as `msb.methods`.
    ours : mapping
        Name -> place of our own, which no package replaces.
    accept : callable
        Takes the name and the value of an entry and returns its part; it may raise `PackageError`.

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
            if kind != "renderer" and not re.match(NAME, entry.name):
                raise PackageError(f"its name must match {NAME}")
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
    """Return the object that an entry point's value, "module" or "module:attribute", names.

    What the package prints meanwhile is a warning, and reaches standard output in no way.
    """
    module, _, attribute = (part.strip() for part in value.partition(":"))
    if not module:
        raise PackageError("its entry point names no module")
    printed = io.StringIO()
    try:
        with _stdout_aside(), contained(printed):
            found: Any = import_module(module)
            for part in filter(None, attribute.split(".")):
                found = getattr(found, part)
    except (PackageError, MsbError) as error:
        raise PackageError(f"it cannot be loaded: {error}") from error
    if text := printed.getvalue().strip():
        warn(f'PACKAGE_PRINTS: module {shorten(module, 80)} prints "{shorten(text, 80)}" when it is imported')
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
def contained(aside: IO[str] | None = None) -> Iterator[None]:
    """Run code of another package: whatever it raises, exits and interrupts with, is a `PackageError`.

    An error of ours stays what it is. What the code prints goes to `aside`, standard error if not given. An
    exception that a signal's handler raised, as when the user presses Ctrl-C, goes on even if the code
    catches it.
    """
    failed: BaseException | None = None
    with _signals_watched() as signalled, contextlib.redirect_stdout(aside or sys.stderr):
        try:
            yield
        except BaseException as error:
            failed = error
    if signalled:
        raise signalled[0]
    if isinstance(failed, MsbError | PackageError):
        raise failed
    if failed is not None:
        text = f"{type(failed).__name__}: {shorten(str(failed), 200)}"
        raise PackageError(text.removesuffix(": ")) from failed


@contextlib.contextmanager
def _signals_watched() -> Iterator[list[BaseException]]:
    """Yield the list to which everything is added that handlers of signals raise; handlers are put back."""
    raised: list[BaseException] = []
    held: dict[int, Any] = {}

    def handle(number: int, frame: Any) -> None:
        try:
            held[number](number, frame)
        except BaseException as error:
            raised.append(error)
            raise

    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")):
            if number is not None and callable(handler := signal.getsignal(number)):
                held[number] = handler
                signal.signal(number, handle)
    try:
        yield raised
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _stdout_aside() -> Iterator[None]:
    """Let what C code and child processes write to standard output go to standard error."""
    try:
        held = os.dup(1)
    except OSError:  # it is closed
        yield
        return
    try:
        _flush()
        os.dup2(2, 1)
        yield
    finally:
        _flush()
        os.dup2(held, 1)
        os.close(held)


def _flush() -> None:
    """Write out what Python and C still hold for standard output."""
    with contextlib.suppress(Exception):  # it is closed or full, or there is no C library of that name
        if sys.__stdout__ is not None:
            sys.__stdout__.flush()
        import ctypes

        ctypes.CDLL(None).fflush(None)
