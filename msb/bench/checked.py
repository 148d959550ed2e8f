"""Check data from outside against a pydantic model; one clear line says what is wrong with it."""

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
Model = TypeVar("Model", bound=BaseModel)


class Record(BaseModel):
    """A model that is read strictly: no unknown key, no NaN, no text for a number."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True, protected_namespaces=()
    )

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Self:
        """Return the model of JSON data of our own, where lists may stand for tuples."""
        return cls.model_validate(data, strict=False)

    def to_json(self) -> bytes:
        """Return the file's content."""
        return self.model_dump_json(by_alias=True, indent=1).encode() + b"\n"


def read_bytes(path: str | os.PathLike[str], max_bytes: int, code: str = "RECORD_INVALID") -> bytes:
    """Return the content of `path`, if it is not longer than `max_bytes`."""
    data = read_file(path, max_bytes)
    if len(data) > max_bytes:
        raise InputError(code, f"it is longer than {max_bytes:,} bytes", file=path)
    return data


def read_json(path: str | os.PathLike[str], max_bytes: int) -> Any:
    """Return the JSON document in `path`: no repeated keys, no NaN, no deep nesting."""
    return parse_json(read_bytes(path, max_bytes), max_bytes, file=path)


def parse_json(data: bytes, max_bytes: int, *, file: object) -> Any:
    """Return the JSON document `data` of a file, as `read_json`."""
    about: dict[str, Any] = {"name": "the file", "error": InputError, "code": "RECORD_INVALID"}
    return parse_strict_json(data, file=file, max_bytes=max_bytes, **about)


def checked(model: type[Model], data: Any, *, file: object, code: str) -> Model:
    """Return as `model` what a JSON or TOML parser of ours gave, or raise `code` about `file`."""
    try:
        # JSON again: only from JSON does a strict model take a list for a tuple.
        return model.model_validate_json(json.dumps(data, allow_nan=False))
    except (TypeError, ValueError) as error:
        if not isinstance(error, ValidationError):  # a date, NaN: TOML has what JSON has not
            raise InputError(code, f"it holds what it may not: {shorten(str(error))}", file=file) from None
        first: Mapping[str, Any] = error.errors(include_url=False)[0]
        place = _place_in(data, first["loc"])
        pointer = "".join(f"/{part}" for part in place) or "/"
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        given = f", found {shorten(repr(first['input']), 40)}"
        said = f"{first['msg'][:1].lower()}{first['msg'][1:]}"
        if first["type"].startswith("missing"):
            said, given = "it is missing", ""
        if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            said, given = _unknown_key(model, place), ""
        text = f"{shorten(pointer)}: {said}{given}{more}"
        raise InputError(code, text, file=file, pointer=pointer) from None


def _place_in(data: Any, place: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Return pydantic's place of an error without the names of the alternatives that a type has."""
    parts: list[str | int] = []
    for number, part in enumerate(place):
        if isinstance(data, dict) and (part in data or number == len(place) - 1):
            parts, data = [*parts, part], data.get(part)
        elif isinstance(data, list) and isinstance(part, int):
            parts, data = [*parts, part], data[part] if part < len(data) else None
    return tuple(parts)


def _unknown_key(model: type[BaseModel], place: tuple[str | int, ...]) -> str:
    """Return in words that a key is not known, with the one that may be meant, or all there are."""
    keys = _keys_at(model, place[:-1])
    near = difflib.get_close_matches(str(place[-1]), keys, 1)
    there = f"did you mean {near[0]}?" if near else f"there are {', '.join(keys)}" if keys else ""
    return "there is no such key" + (f"; {there}" if there else "")


def _keys_at(model: type[BaseModel], place: tuple[str | int, ...]) -> list[str]:
    """Return the keys of the table at `place` below `model`; none where that is no table of one model."""
    names = [part for part in place if isinstance(part, str)]
    here: Any = model
    for name in names:
        field = here.model_fields.get(name)
        models = [] if field is None else _models(field.annotation)
        if len(models) != 1:
            return []
        here = models[0]
    return list(here.model_fields)


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that stand in the annotation of a field: of list[A] | None it is A."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [one for part in get_args(annotation) for one in _models(part)]
