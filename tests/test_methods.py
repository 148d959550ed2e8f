"""The table of methods and everything that has a line for each of them agree: docs/extending.md."""

from __future__ import annotations

from data_stubs.trained import _WRITERS
from msb.adapters.exporter import ADAPTERS
from msb.methods import METHODS
from msb.reference import RENDERERS
from msb.scenes.datasets.rules import OURS, RULES
from tests.conftest import ROOT

TRAINED = {name for name, method in METHODS.items() if method.native is not None}
"""Methods with a representation of their own; the others are only shown as meshes, or not at all."""


def test_every_method_has_an_adapter() -> None:
    assert ADAPTERS.keys() == METHODS.keys()


def test_every_method_with_a_reference_tier_has_a_reference_and_golden_images() -> None:
    assert RENDERERS.keys() == {name for name, method in METHODS.items() if method.supports("reference")}
    for name in RENDERERS:
        assert list((ROOT / "tests" / "golden" / name).glob("*/views.npz")), name
        assert (ROOT / "tests" / "reference" / f"test_golden_{name}.py").exists()


def test_every_trained_method_is_drawn_on_the_dedicated_tier_and_has_a_model_among_the_stubs() -> None:
    assert {name for name, method in METHODS.items() if method.supports("dedicated")} == TRAINED
    assert _WRITERS.keys() == TRAINED


def test_every_method_says_how_its_own_code_reads_datasets() -> None:
    assert RULES.keys() - {OURS} == METHODS.keys() - {"mesh"}
