"""The options of a bake: one object checks them for the function, the command and a protocol."""

import math
from typing import Any, get_args, get_type_hints

import pytest

from msb.asset.texture import MAX_SIDE
from msb.bake.options import BakeKeywords, BakeOptions, parse_collision
from msb.errors import UsageError

INVALID: list[dict[str, Any]] = [
    {"geometry": "solid"},
    {"color": "face"},
    {"teacher": "me"},
    {"texture": 8},
    {"texture": MAX_SIDE + 1},
    {"faces": 0},
    {"seconds": -1},
    {"seconds": math.nan},
    {"seconds": math.inf},
    {"seed": -1},
    {"up": "z"},
    {"for_solid": True, "geometry": "kept"},
    {"faces": 9, "geometry": "kept"},
    {"texture": 64, "color": "vertex"},
    *({"lods": text} for text in ("", "half", "0.5,", "1,0.5", "0", "-0.5", "nan", "0.25,0.5", "0.5,0.5")),
    *({"lods": shares} for shares in ((0.5, 0.5), (math.nan,))),
    *({"collision": text} for text in ("", "mesh", "mesh:", "mesh:3", "mesh:1e3", "hulls:0", "box:2")),
]


@pytest.mark.parametrize("options", INVALID, ids=str)
def test_invalid_values_and_contradictions_are_rejected(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError) as caught:
        BakeOptions(**options)
    assert caught.value.code == "USAGE"
    assert f"--{next(iter(options)).replace('_', '-')} " in caught.value.message


def test_shares_and_shapes_are_parsed() -> None:
    assert BakeOptions(lods="0.5, 0.25,0.1").shares == BakeOptions(lods=(0.5, 0.25, 0.1)).shares
    assert BakeOptions(lods=(0.5, 0.25)).shares == (0.5, 0.25)
    assert BakeOptions().shares == BakeOptions(lods=()).shares == ()
    shapes = [parse_collision(text) for text in ("mesh:1000", "hulls:16", "box")]
    assert shapes == [("mesh", 1000), ("hulls", 16), ("box", 1)]


def test_keywords_of_the_function_are_the_fields_of_the_object() -> None:
    fields, keywords = get_type_hints(BakeOptions), get_type_hints(BakeKeywords)
    assert list(fields) == list(keywords)
    for name, kind in fields.items():
        assert set(get_args(keywords[name])) <= set(get_args(kind)), name
        assert get_args(kind) or kind is keywords[name]
    texture = get_type_hints(BakeOptions, include_extras=True)["texture"].__metadata__[0]
    assert texture.most == MAX_SIDE
