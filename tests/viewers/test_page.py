"""The pages of the viewers: their data, no requests to a network, and escaping of file names."""

import base64
import re
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb_viewers.model import ViewModel
from msb_viewers.page import page
from msb_viewers.state import ViewState
from tests.viewers.test_compare_page import meta_of, page_text


def parts(model: ViewModel) -> tuple[str, dict[str, Any], dict[str, np.ndarray]]:
    text = page(model, ViewState.first(model), model.up).decode()
    meta = meta_of(text)
    packed = re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1]
    raw = zlib.decompress(base64.b64decode(packed))
    arrays = {
        name: np.frombuffer(raw, spec["dtype"], spec["length"], spec["offset"])
        for name, spec in meta["arrays"].items()
    }
    return text, meta, arrays


def test_the_page_holds_the_model(faults: ViewModel) -> None:
    _, meta, arrays = parts(faults)
    assert (arrays["points"].reshape(-1, 3) == faults.points).all()
    assert (arrays["faces"].reshape(-1, 3) == faults.faces).all()
    assert (arrays["colors"].reshape(-1, 3) == faults.colors.values).all()
    for layer in meta["layers"]:
        assert layer["count"] == len(faults.layers[layer["kind"]])
        assert len(arrays[layer["kind"]]) == layer["count"] * layer["each"]
    assert set(meta["visible"]) == faults.default_layers()


def test_size_classes_of_the_page_agree_with_the_model(demo: ViewModel) -> None:
    classes = demo.size_class_of_faces()
    assert (classes[demo.face_component == 0] == 0).all()
    _, meta, _ = parts(demo)
    for index, row in enumerate(meta["classes"]):
        wanted = len(np.unique(demo.face_component[classes == index]))
        assert row["components"] == wanted


@pytest.mark.parametrize("viewer", ["view", "compare"])
def test_a_page_loads_nothing(viewer: str, faults: ViewModel) -> None:
    text = parts(faults)[0] if viewer == "view" else page_text()
    assert "default-src 'none'" in text
    addresses = set(re.findall(r"https?://[^\s\"']+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}  # the name of the SVG namespace
    assert not re.search(r"\b(fetch|XMLHttpRequest|import)\s*\(|src=|href=", text)


@pytest.mark.parametrize("viewer", ["view", "compare"])
def test_a_hostile_name_is_escaped(viewer: str, faults: ViewModel) -> None:
    name = "</script><script>alert(1)</script>@DATA@"
    text = parts(replace(faults, name=name))[0] if viewer == "view" else page_text(name)
    assert meta_of(text)["name"] == name
    assert text.count("<script") == 3
