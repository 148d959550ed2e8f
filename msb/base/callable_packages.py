"""Packages of the public API that can be called like the function of their name, such as `msb.render`."""

from __future__ import annotations

import inspect
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package whose call is that of its function of the same name: ``msb.render(asset, camera)``.

    Importing the package `msb.render` sets the attribute `render` of `msb` to this package, so no
    `__getattr__` of `msb` can return the function instead. A package opts in by
    ``sys.modules[__name__].__class__ = CallablePackage``.
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self._function(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:  # what editors show
        return inspect.signature(self._function)

    @property
    def _function(self) -> Any:
        return getattr(self, self.__name__.rpartition(".")[2])
