"""Every method has the modules, tests and data that its declaration in the registry requires."""

from data_stubs.made_models import _WRITERS
from msb.adapters.exporter import adapters
from msb.registry import BUILT_IN, METHODS, with_role
from msb.scenes.datasets.rulebook import OURS, RULES
from tests.conftest import ROOT

TRAINED = {name for name, method in METHODS.items() if method.native is not None}
"""Methods with a trained representation. The other methods have meshes only."""


def test_every_method_has_an_adapter() -> None:
    assert list(adapters()) == list(BUILT_IN)


def test_the_registry_lists_every_folder() -> None:
    folders = {path.parent.name for path in (ROOT / "msb" / "methods").glob("*/__init__.py")}
    assert folders == set(BUILT_IN) == METHODS.keys()


def test_every_method_with_a_reference_tier_has_a_reference_and_golden_images() -> None:
    supported = {name for name, method in METHODS.items() if method.supports("reference")}
    assert {name for name, _ in with_role("reference")} == supported
    tests = [*(ROOT / "tests" / "reference").glob("test_golden_*.py")]
    for name in supported:
        assert list((ROOT / "tests" / "golden" / name).glob("*/views.npz")), name
        assert any(f'"{name}"' in test.read_text() for test in tests), name


def test_every_trained_method_has_a_dedicated_tier_and_a_demo_model() -> None:
    assert {name for name, method in METHODS.items() if method.supports("dedicated")} == TRAINED
    assert {name for name, _ in with_role("native")} == {name for name, _ in with_role("official")} == TRAINED
    assert _WRITERS.keys() == TRAINED


def test_every_method_declares_how_its_code_reads_datasets() -> None:
    assert RULES.keys() - {OURS} == METHODS.keys() - {"mesh", "trisplat"}
