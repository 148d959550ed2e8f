"""Check data from outside against a pydantic model; one clear line says what is wrong with it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from msb.asset.strict_json import parse_strict_json
from msb.errors import AssetError, InputError, shorten
from msb.files import read_file

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

Model = TypeVar("Model", bound=BaseModel)


def read_bytes(path: str | os.PathLike[str], max_bytes: int, code: str = "RECORD_INVALID") -> bytes:
    """Return the content of `path`, if it is not longer than `max_bytes`.

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE or, where it is longer, `code`.
    """
    data = read_file(path, max_bytes)
    if len(data) > max_bytes:
        raise InputError(code, f"it is longer than {max_bytes:,} bytes", file=path)
    return data


def read_json(path: str | os.PathLike[str], max_bytes: int) -> Any:
    """Return the JSON document in `path`: no repeated keys, no NaN, no deep nesting.

    Raises
    ------
    InputError
        FILE_NOT_FOUND, FILE_UNREADABLE or RECORD_INVALID.
    """
    data = read_bytes(path, max_bytes)
    try:
        return parse_strict_json(data, file=path, name="the file", max_bytes=max_bytes)
    except AssetError as error:
        raise InputError("RECORD_INVALID", error.message, file=path, pointer=error.pointer) from None


def checked(model: type[Model], data: Any, *, file: object, code: str) -> Model:
    """Return `data` as `model`.

    Parameters
    ----------
    model : type of BaseModel
    data : object
        The data that a JSON or TOML parser gave, nested no deeper than our parsers allow.
    file : path-like
        The file, for the error message.
    code : str
        The code of the error.

    Raises
    ------
    InputError
        `code`: the first thing wrong, with its place as a JSON pointer.
    """
    try:
        # JSON again: only from JSON does a strict model take a list for a tuple.
        return model.model_validate_json(json.dumps(data, allow_nan=False))
    except (TypeError, ValueError) as error:
        if not isinstance(error, ValidationError):  # a date, NaN: TOML has what JSON has not
            raise InputError(code, f"it holds what it may not: {shorten(str(error))}", file=file) from None
        first: Mapping[str, Any] = error.errors(include_url=False)[0]
        pointer = "".join(f"/{part}" for part in first["loc"]) or "/"
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        found = "" if first["type"] == "missing" else f", found {shorten(repr(first['input']), 40)}"
        text = f"{shorten(pointer)}: {first['msg'][:1].lower()}{first['msg'][1:]}{found}{more}"
        raise InputError(code, text, file=file, pointer=pointer) from None
