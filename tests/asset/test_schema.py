"""The JSON Schema: validity, agreement with the code, and results compared with `jsonschema`."""

import copy
import random
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import jsonschema
import pytest

from msb.asset import Manifest
from msb.asset.check import check_manifest
from msb.asset.manifest import (
    DTYPES,
    BoundingSphere,
    Bounds,
    BufferSpec,
    CoordinateFrame,
    Source,
    SourceFile,
    StoredSetting,
)
from msb.asset.schema import check_schema, manifest_schema
from msb.base.packages import NAME
from msb.errors import AssetError
from msb.registry import METHODS, PASSES, SETTING_SOURCES, TIERS
from tests.corpus.good import decoder, mesh, parts, soup

SCHEMA = manifest_schema()
PROPERTIES = SCHEMA["properties"]
BUFFER = PROPERTIES["buffers"]["additionalProperties"]
SCALARS = [0, 1, -1, 3, 2**32 - 1, 2**32, 2**63 - 1, 2**63, 2**64, 1.5, -0.25, 1e308, True, False, None]
SCALARS += ["", "x", "1.0", "2.7", "triasset", "mesh", "vertex", "opaque_unlit", "float32", "\u00e9"]
SCALARS += ["0" * 64, "buffers/a.bin", "x" * 1001]
KEYS = ["x", "positions", "indices", "Bad Name", "a.b", "value", "min", "files", "kernel", "reference"]


def subschemas(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield `schema` and all schemas inside it."""
    yield schema
    for key in ("properties",):
        for inner in schema.get(key, {}).values():
            yield from subschemas(inner)
    for key in ("additionalProperties", "items", "propertyNames"):
        if key in schema:
            yield from subschemas(schema[key])


def is_valid(manifest: Any) -> bool:
    return all(item.severity != "error" for item in check_schema(manifest, SCHEMA))


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every (container, key) in JSON data."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in list(pairs):
        yield value, key
        if isinstance(inner, dict | list):
            yield from places(inner)


def junk(rng: random.Random, depth: int = 0) -> Any:
    kind = rng.random()
    if depth < 2 and kind < 0.15:
        return [junk(rng, depth + 1) for _ in range(rng.randrange(5))]
    if depth < 2 and kind < 0.3:
        return {rng.choice(KEYS): junk(rng, depth + 1) for _ in range(rng.randrange(4))}
    return rng.choice(SCALARS)


def mutate(manifest: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    manifest = copy.deepcopy(manifest)
    for _ in range(rng.choice((1, 1, 2))):
        container, key = rng.choice(list(places(manifest)))
        kind = rng.random()
        if kind < 0.15:
            del container[key]
        elif kind < 0.3 and isinstance(container, dict):
            container[rng.choice(KEYS)] = junk(rng)
        else:
            container[key] = junk(rng)
    return manifest


def test_it_is_a_schema_of_draft_2020_12() -> None:
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.slow
@pytest.mark.parametrize("make", [mesh, soup, decoder])
def test_results_for_mutated_manifests_agree_with_jsonschema(make: Any) -> None:
    good = parts(make()).manifest
    validator = jsonschema.Draft202012Validator(SCHEMA)
    rng = random.Random(make.__name__)
    verdicts = []
    for _ in range(400):
        manifest = mutate(good, rng)
        verdicts.append(is_valid(manifest))
        assert verdicts[-1] == validator.is_valid(manifest), manifest
    assert is_valid(good)
    assert 25 < sum(verdicts) < 375


def test_only_supported_keywords_are_used() -> None:
    known = {"type", "const", "enum", "pattern", "minimum", "maximum", "minItems", "maxItems", "maxLength"}
    known |= {"maxProperties", "required", "properties", "additionalProperties", "propertyNames", "items"}
    used = {key for schema in subschemas(SCHEMA) for key in schema}
    assert used - known == {"$schema", "title", "description", "x-code", "x-closed"}
    assert used >= known


def test_every_code_it_names_is_registered() -> None:
    assert {schema["x-code"] for schema in subschemas(SCHEMA) if "x-code" in schema} <= AssetError.codes


def test_every_object_reports_unknown_keys() -> None:
    for schema in subschemas(SCHEMA):
        if schema.get("type") == "object":
            assert schema.get("x-closed", False) != ("additionalProperties" in schema)


def test_its_lists_are_those_of_the_code() -> None:
    assert all(re.search(PROPERTIES["method"]["pattern"], name) for name in METHODS)
    assert (
        PROPERTIES["method"]["pattern"] == PROPERTIES["coverage"]["properties"]["kernel"]["pattern"] == NAME
    )
    tiers = PROPERTIES["required_passes"]["properties"]
    assert list(tiers) == list(TIERS)
    assert all(tier["items"]["enum"] == list(PASSES) for tier in tiers.values())
    assert PROPERTIES["settings"]["additionalProperties"]["properties"]["source"]["enum"] == list(
        SETTING_SOURCES
    )
    assert BUFFER["properties"]["dtype"]["enum"] == list(DTYPES)


@pytest.mark.parametrize(
    ("schema", "kind"),
    [
        (PROPERTIES["bounds"], Bounds),
        (PROPERTIES["bounding_sphere"], BoundingSphere),
        (PROPERTIES["settings"]["additionalProperties"], StoredSetting),
        (PROPERTIES["coordinate_frame"], CoordinateFrame),
        (PROPERTIES["source"], Source),
        (PROPERTIES["source"]["properties"]["files"]["items"], SourceFile),
        (BUFFER, BufferSpec),
    ],
)
def test_objects_have_the_keys_of_their_dataclass(schema: dict[str, Any], kind: type) -> None:
    names = [field.name for field in fields(kind)]
    assert list(schema["properties"]) == names
    assert schema["required"] == names


def test_the_manifest_has_the_keys_of_its_dataclass() -> None:
    names = {field.name for field in fields(Manifest)} - {"extra"}
    optional = {"training", "primitive", "origin", "up", "unit", "floor"}
    assert set(PROPERTIES) == names == {*SCHEMA["required"], *optional}
    plain = mesh().manifest
    assert list(plain.to_dict()) == SCHEMA["required"]
    trained = replace(plain, training={"eval": False, "images": "images_4"})
    assert Manifest.from_dict(trained.to_dict()) == trained
    assert not check_manifest(trained.to_dict())


@pytest.mark.parametrize("wrong", [{"eval": 0}, {"images": "/home/me/images"}, {"width": 0}, {"seed": 1}])
def test_invalid_keys_of_training_are_findings(wrong: dict[str, Any]) -> None:
    assert check_manifest(replace(mesh().manifest, training=wrong).to_dict())
