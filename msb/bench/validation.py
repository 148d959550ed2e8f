"""Validate JSON and TOML files against pydantic models. An invalid file gives a single clear error line."""

import difflib
import json
import os
from collections.abc import Mapping
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from msb.asset.strict_json import parse_strict_json
from msb.base.files import read_file
from msb.errors import InputError, shorten

Name = Annotated[str, Field(min_length=1, max_length=200)]
Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
ModelType = TypeVar("ModelType", bound=BaseModel)


class Record(BaseModel):
    """A strict model: it rejects unknown keys, NaN, infinity, and strings in place of numbers."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True, protected_namespaces=()
    )

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Self:
        """Return a record from trusted data, which may contain lists in place of tuples."""
        return cls.model_validate(data, strict=False)

    def to_json(self) -> bytes:
        """Return the record as the content of a JSON file."""
        return self.model_dump_json(by_alias=True, indent=1).encode() + b"\n"


def read_bytes(path: str | os.PathLike[str], max_bytes: int, code: str = "RECORD_INVALID") -> bytes:
    """Return the content of a file. A file longer than `max_bytes` raises an error with `code`."""
    data = read_file(path, max_bytes)
    if len(data) > max_bytes:
        raise InputError(code, f"the file is longer than {max_bytes:,} bytes", file=path)
    return data


def read_json(path: str | os.PathLike[str], max_bytes: int) -> Any:
    """Return the JSON document in a file. Repeated keys, NaN and deep nesting are errors."""
    return parse_json(read_bytes(path, max_bytes), max_bytes, file=path)


def parse_json(data: bytes, max_bytes: int, *, file: object) -> Any:
    """Return the JSON document in `data`, checked as in `read_json`. Error messages name `file`."""
    about: dict[str, Any] = {"name": "the file", "error": InputError, "code": "RECORD_INVALID"}
    return parse_strict_json(data, file=file, max_bytes=max_bytes, **about)


def validate(model: type[ModelType], data: Any, *, file: object, code: str) -> ModelType:
    """Return parsed JSON or TOML as a `model`.

    If the data of `file` is invalid, raise an InputError with `code`.

    The error names the place of the first mistake as a JSON pointer, and the number of further mistakes.
    """
    try:
        # validate JSON text, because strict models accept lists as tuples only in JSON
        return model.model_validate_json(json.dumps(data, allow_nan=False))
    except (TypeError, ValueError) as error:
        if not isinstance(error, ValidationError):  # TOML allows dates and NaN, JSON does not
            text = f"the file contains an invalid value: {shorten(str(error))}"
            raise InputError(code, text, file=file) from None
        first: Mapping[str, Any] = error.errors(include_url=False)[0]
        place = _find_place(data, first["loc"])
        pointer = "".join(f"/{part}" for part in place) or "/"
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        given = f", found {shorten(repr(first['input']), 40)}"
        fault = f"{first['msg'][:1].lower()}{first['msg'][1:]}"
        if first["type"].startswith("missing"):
            fault, given = "this key is missing", ""
        if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            fault, given = _describe_unknown_key(model, place), ""
        text = f"{shorten(pointer)}: {fault}{given}{more}"
        raise InputError(code, text, file=file, pointer=pointer) from None


def _find_place(data: Any, place: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Return the location of a pydantic error as a list of keys."""
    parts: list[str | int] = []
    for number, part in enumerate(place):
        if isinstance(data, dict) and (part in data or number == len(place) - 1):
            parts, data = [*parts, part], data.get(part)
        elif isinstance(data, list) and isinstance(part, int):
            parts, data = [*parts, part], data[part] if part < len(data) else None
    return tuple(parts)


def _describe_unknown_key(model: type[BaseModel], place: tuple[str | int, ...]) -> str:
    """Return the message for an unknown key. The message names the most similar key, or all keys."""
    keys = _list_keys(model, place[:-1])
    similar = difflib.get_close_matches(str(place[-1]), keys, 1)
    hint = f"; did you mean {similar[0]}?" if similar else f"; known keys: {', '.join(keys)}" if keys else ""
    return f"unknown key{hint}"


def _list_keys(model: type[BaseModel], place: tuple[str | int, ...]) -> list[str]:
    """Return the keys that `model` allows at the location `place`.

    If several models are possible at `place`, the function returns an empty list.
    """
    current: Any = model
    for name in place:
        if isinstance(name, str):
            field = current.model_fields.get(name)
            models = [] if field is None else _find_models(field.annotation)
            if len(models) != 1:
                return []
            current = models[0]
    return list(current.model_fields)


def _find_models(annotation: Any) -> list[type[BaseModel]]:
    """Return all models in a type annotation. For the annotation `list[A] | None`, return A."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _find_models(part)]
