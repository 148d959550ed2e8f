"""Packages whose names are imported on first use, some of which can also be called as a function."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any


class _LazyPackage(ModuleType):
    _homes: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self._homes:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = getattr(import_module(self._homes[name]), name)
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._homes})

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._function(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:  # what editors and notebooks show
        return inspect.signature(self._function)

    @property
    def _function(self) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])


def make_lazy(package: str, homes: Mapping[str, str]) -> None:
    """Import the public names of a package when they are first used.

    A package can be called if it has a public function of its own name: ``msb.render(asset, camera)`` is
    ``msb.render.render(asset, camera)``, while ``msb.render.images`` still is a module. Help of a command
    thus costs no import of NumPy, though the command lives in the package that does the work.

    Parameters
    ----------
    package : str
        Its full name, ``__name__`` of the caller.
    homes : mapping
        Public name -> the module that defines it.
    """
    module: Any = sys.modules[package]
    module.__class__ = _LazyPackage
    module._homes = homes
