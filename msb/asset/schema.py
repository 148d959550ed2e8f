"""Check a parsed manifest against the JSON Schema triasset.schema.json.

The schema file defines all keys and their values. This module interprets the few keywords of JSON Schema that
the schema file uses. This module does not use `jsonschema`, because reading an asset must only need NumPy and
the standard library. A test compares the results of this module with the results of the library `jsonschema`.

The schema has two additional keywords. `x-code` is the error code of a violation, by default TRIASSET_FIELD.
`x-closed` marks objects whose unknown keys cause a warning. Unlike in JSON Schema, the number ``4.0`` is not
an integer.
"""

import json
import math
import re
from collections.abc import Iterator
from functools import cache
from importlib import resources
from typing import Any

from msb.asset.strict_json import has_lone_surrogate
from msb.errors import Finding, finding, shorten

Schema = dict[str, Any]

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "null": (type(None),),
}
_PLURALS = {"object": "an object", "array": "an array", "integer": "an integer", "null": "null"}


@cache
def manifest_schema() -> Schema:
    """Return the JSON Schema of the manifest."""
    text = resources.files("msb.asset").joinpath("triasset.schema.json").read_text(encoding="utf-8")
    schema: Schema = json.loads(text)
    return schema


def check_schema(value: Any, schema: Schema, pointer: str = "") -> Iterator[Finding]:
    """Yield a finding for each violation of `schema` in `value`.

    The argument `pointer` is the JSON pointer of `value`.
    """
    code = schema.get("x-code", "TRIASSET_FIELD")
    here = pointer or "the manifest"
    if not _has_type(value, schema.get("type")):
        text = f"{here} is {describe(value)}; it must be {_type_names(schema['type'])}"
        yield finding(code, text, pointer=pointer, value=value)
        return
    for problem in _scalar_problems(value, schema):
        text = f"{here} is {describe(value)}; it must {problem}"
        yield finding(code, text, pointer=pointer, value=value)
    if isinstance(value, dict):
        yield from _check_object(value, schema, pointer)
    elif isinstance(value, list) and "items" in schema:
        for index, item in enumerate(value[: schema.get("maxItems", len(value))]):
            yield from check_schema(item, schema["items"], f"{pointer}/{index}")


def _check_object(value: dict[str, Any], schema: Schema, pointer: str) -> Iterator[Finding]:
    properties: dict[str, Schema] = schema.get("properties", {})
    others: Schema | None = schema.get("additionalProperties")
    names: Schema = schema.get("propertyNames", {})
    here = pointer or "the manifest"
    for key in schema.get("required", ()):
        if key not in value:
            text = f'{here} lacks the required key "{key}"'
            yield finding("TRIASSET_FIELD", text, pointer=f"{pointer}/{key}")
    most = schema.get("maxProperties", len(value))
    if len(value) > most:
        text = f"{pointer} has {len(value)} entries; at most {most} are allowed"
        yield finding("TRIASSET_FIELD", text, pointer=pointer, value=len(value), limit=most)
        return
    for key, item in value.items():
        below = f"{pointer}/{escape(key)}"
        for problem in _scalar_problems(key, names):
            text = f'{pointer} has the name "{shorten(key)}"; a name must {problem}'
            yield finding(names["x-code"], text, pointer=below, value=key)
        if key in properties:
            yield from check_schema(item, properties[key], below)
        elif others is not None:
            yield from check_schema(item, others, below)
        elif schema.get("x-closed"):
            text = f'{here} has the unknown key "{shorten(key)}", which is ignored'
            yield finding("TRIASSET_FIELD_UNKNOWN", text, severity="warning", pointer=below)


def _has_type(value: Any, wanted: str | list[str] | None) -> bool:
    if wanted is None:
        return True
    names = [wanted] if isinstance(wanted, str) else wanted
    if isinstance(value, bool):  # In Python, a bool is also an int.
        return "boolean" in names
    return any(isinstance(value, _TYPES[name]) for name in names)


def _scalar_problems(value: Any, schema: Schema) -> Iterator[str]:
    """Yield each rule that `value` violates.

    Each rule is a text that continues a sentence after "must". The type of `value` must already be valid.
    """
    if "const" in schema and value != schema["const"]:
        yield f'be "{schema["const"]}"'
    if "enum" in schema and value not in schema["enum"]:
        yield f"be one of {', '.join(schema['enum'])}"
    if isinstance(value, str):
        if has_lone_surrogate(value):  # Only a manifest built in memory can have such a value.
            yield "not contain half of a surrogate pair"
        elif len(value) > schema.get("maxLength", len(value)):
            yield f"have at most {schema['maxLength']} characters"
        # In JSON Schema, "$" does not match before a final line break, unlike in Python.
        elif "pattern" in schema and not re.search(schema["pattern"].replace("$", r"\Z"), value):
            yield f"match {schema['pattern']}"
    elif isinstance(value, list):
        least, most = schema.get("minItems", 0), schema.get("maxItems", len(value))
        if not least <= len(value) <= most:
            yield f"have {least} items" if least == most else f"have {least} to {most} items"
    elif isinstance(value, int | float) and not isinstance(value, bool):
        # Only a manifest built in memory can have such a value.
        if isinstance(value, float) and not math.isfinite(value):
            yield "be finite"
        if value < schema.get("minimum", value):
            yield f"be at least {schema['minimum']}"
        if value > schema.get("maximum", value):
            yield f"be at most {schema['maximum']}"


def _type_names(wanted: str | list[str]) -> str:
    names = [wanted] if isinstance(wanted, str) else wanted
    return " or ".join(_PLURALS.get(name, f"a {name}") for name in names)


def describe(value: Any) -> str:
    """Return `value` as short JSON text for an error message.

    For an object or a long array, return only its type.
    """
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        short = len(value) <= 4 and not any(isinstance(item, dict | list) for item in value)
        return shorten(str(value), 60) if short else "an array"
    if isinstance(value, str):
        return f'"{shorten(value, 60)}"'
    return shorten(json.dumps(value, default=repr), 60)


def escape(key: str) -> str:
    """Return `key` as a token of a JSON pointer (RFC 6901), shortened for messages."""
    return shorten(key, 60).replace("~", "~0").replace("/", "~1")
