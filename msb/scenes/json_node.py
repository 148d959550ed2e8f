"""JSON of camera files as a tree of nodes that know their position in the file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.schema import describe, escape
from msb.asset.strict_json import parse_strict_json
from msb.errors import SceneError
from msb.scenes.source import Source

# Largest file in bytes. A file of 16 MiB contains about 30,000 cameras, and is parsed in seconds. The largest
# public captures have several thousand cameras.
MAX_BYTES = 1 << 24


def read_json(source: Source) -> Node:
    """Return the root of the JSON document in `source`."""
    value = parse_strict_json(
        bytes(source.data[: MAX_BYTES + 1]),
        file=source.path,
        name="the file",
        max_bytes=MAX_BYTES,
        error=SceneError,
        code="CAMERA_FILE",
    )
    return Node(source, value, "")


@dataclass(frozen=True)
class Node:
    """A JSON value and its position in the file as an RFC 6901 pointer ("" is the root).

    If the value has another kind than the method expects, a method raises `SceneError` CAMERA_FILE.
    """

    source: Source
    value: Any
    pointer: str

    def error(self, code: str, message: str) -> SceneError:
        """Return an error about this JSON value."""
        text = message if self.pointer else f"the document {message.removeprefix('it ')}"
        return self.source.error(code, text, pointer=self.pointer)

    def abbreviated(self) -> str:
        """Return this value as text for a message.

        If the text is long, the kind of the value replaces the text.
        """
        return describe(self.value)

    def wrong_type(self, wanted: str) -> SceneError:
        """Return the error for a value of a wrong type. `wanted` describes the valid type."""
        return self.error("CAMERA_FILE", f"it is {self.abbreviated()}; it must be {wanted}")

    def get(self, key: str) -> Node | None:
        """Return the member `key` of this object, or None if it is missing."""
        if not isinstance(self.value, dict):
            raise self.wrong_type("an object")
        if key not in self.value:
            return None
        return Node(self.source, self.value[key], f"{self.pointer}/{escape(key)}")

    def __getitem__(self, key: str) -> Node:
        """Return the member `key` of this object. A missing key is an error."""
        member = self.get(key)
        if member is None:
            raise self.error("CAMERA_FILE", f'it does not have the key "{key}"')
        return member

    def items(self) -> Iterator[Node]:
        """Yield the items of this array."""
        if not isinstance(self.value, list):
            raise self.wrong_type("an array")
        for index, item in enumerate(self.value):
            yield Node(self.source, item, f"{self.pointer}/{index}")

    def only(self, *keys: str) -> None:
        """Raise an error if this object has a member that is not in `keys`."""
        for key in self.value:
            if key not in keys:
                text = f'it has the unknown key "{escape(key)}"; valid keys are {", ".join(keys)}'
                raise self.error("CAMERA_FILE", text)

    def text(self) -> str:
        """Return this string."""
        if not isinstance(self.value, str):
            raise self.wrong_type("a string")
        return self.value

    def number(self) -> float:
        """Return this number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.wrong_type("a number")
        return float(self.value)

    def whole(self) -> int:
        """Return this value as a whole number. ``800.0`` is accepted because some exporters write it."""
        number = self.number()
        if number != math.floor(number):
            raise self.wrong_type("a whole number")
        return int(self.value)

    def array(self, *shape: int) -> NDArray[np.float64]:
        """Return this array of numbers with the given shape."""
        if not _has_shape(self.value, shape):
            raise self.wrong_type(f"{' x '.join(map(str, shape))} numbers")
        return np.array(self.value, dtype=np.float64)

    def locating(self) -> AbstractContextManager[None]:
        """In the block, add the position of this value to errors, like `Source.locating`."""
        return self.source.locating(self.pointer)


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    """Return whether `value` consists of nested lists of numbers with this shape."""
    if not shape:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, list) and len(value) == shape[0] and all(_has_shape(v, shape[1:]) for v in value)
