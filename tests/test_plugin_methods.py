"""A method of another package (the example of docs/extending.md) that is installed, missing or broken.

Unexpected warnings fail these tests.
"""

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import registry
from msb.adapters.exporter import detect
from msb.base.packages import PackageWarning
from msb.cl import open_device
from msb.metrics import registry as metric_registry
from msb.registry import BUILT_IN, METHODS
from tests.conftest import ROOT
from tests.test_docs_commands import install_example

TWO_DTS = ROOT / "tests" / "tiny" / "models" / "walled" / "two_dts"
CAMERA = msb.Camera.look_at((0, 0, 3), (0, 0, 0), up=(0, 1, 0), width=96, height=72, fov_y=0.9)


def clear_caches() -> None:
    """Clear the caches of installed packages, so that msb searches for packages again."""
    registry._installed.cache_clear()
    registry._loadable.cache_clear()
    metric_registry._installed.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] == "msb_facets"]:
        del sys.modules[name]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make a model of the package's method in the current folder.

    Return the folder of the installed package.
    """
    folder = install_example("docs/extending.md", tmp_path / "site")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.chdir(tmp_path)
    clear_caches()
    runpy.run_path(str(folder / "make_facets.py"))
    yield folder
    monkeypatch.undo()
    clear_caches()


def test_the_method_is_listed_and_detected(site: Path) -> None:
    assert list(METHODS) == [*BUILT_IN, "facets"]
    assert METHODS["facets"].title == "Facets"
    assert detect("facets.npz") == "facets"
    assert detect(".") == "facets"
    assert msb.export(".", settings={"sharpness": 2}).manifest.settings["sharpness"].value == 2
    assert detect(TWO_DTS) == "two_dts"


@pytest.mark.slow
@pytest.mark.parametrize("style", ["cpu", "gpu"])
@pytest.mark.parametrize("order", ["tile", "none"])
def test_its_kernels_match_its_reference(site: Path, style: Any, order: str) -> None:
    asset = msb.export("facets.npz")
    modes: dict[str, Any] = {"background": (1, 1, 1), "settings": {"sharpness": 2.5}, "order": order}
    expected = msb.render(asset, CAMERA, tier="reference", **modes)
    with open_device("cpu", style=style) as device:
        frame = msb.render(asset, CAMERA, tier="dedicated", device=device, **modes)
    np.testing.assert_allclose(frame.image, expected.image, atol=2e-6)
    np.testing.assert_array_equal(frame.visible, expected.visible)
    assert frame.alpha.max() > 0.9
    assert frame.image.std() > 0.05


def test_without_its_package_an_asset_has_the_standard_tier(site: Path) -> None:
    asset = msb.export("facets.npz")
    before = msb.audit(asset).to_dict(), msb.render(asset, CAMERA).image
    msb.save(asset, "facets.triasset")
    sys.path.remove(str(site))
    clear_caches()
    asset = msb.load("facets.triasset")
    assert [(w.code, w.severity) for w in asset.warnings] == [("TRIASSET_METHOD_NOT_INSTALLED", "warning")]
    assert "facets" in asset.warnings[0].message
    assert msb.audit(asset).to_dict()["counts"] == before[0]["counts"]
    np.testing.assert_array_equal(msb.render(asset, CAMERA).image, before[1])
    msb.save(asset, "again.triasset")
    assert msb.load("again.triasset").manifest.method == "facets"
    for tier in ("dedicated", "reference"):
        with pytest.raises(msb.Unsupported, match="facets") as caught:
            msb.Renderer(asset, tier=tier)
        assert (caught.value.code, caught.value.exit_status) == ("UNSUPPORTED_TIER", 4)


@pytest.mark.parametrize(
    ("entry", "text", "why"),
    [
        ("facets = msb_facets", "import nothing_of_that_name\n", "ModuleNotFoundError"),
        ("facets = msb_facets", "1 / 0\n", "ZeroDivisionError"),
        ("facets = msb_facets", "", "no attribute 'METHOD'"),
        ("facets = msb_facets", "METHOD = 'Facets'\n", "not an msb.registry.Method"),
        ("facets = msb_facets", "import sys; sys.exit()\n", "SystemExit"),
        ("facets =", None, "msb-facets"),
        ("two_dts = msb_facets", None, "msb.methods.two_dts"),
        ("Face-ts = msb_facets", None, "Face-ts"),
    ],
)
def test_a_broken_package_gives_one_warning(site: Path, entry: str, text: str | None, why: str) -> None:
    (site / "msb_facets-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.methods]\n{entry}\n")
    if text is not None:
        (site / "msb_facets" / "__init__.py").write_text(text)
    clear_caches()
    with pytest.warns(PackageWarning, match=f"^PACKAGE_LEFT_OUT: .*{why}") as caught:
        assert list(METHODS) == list(BUILT_IN)
    assert len(caught) == 1
    assert msb.export(TWO_DTS).manifest.method == "two_dts"


@pytest.mark.parametrize("text", ["1 / 0\n", "def recognises(content):\n    1 / 0\n"])
def test_a_failing_adapter_does_not_affect_other_models(site: Path, text: str) -> None:
    (site / "msb_facets" / "adapter.py").write_text(text)
    clear_caches()
    with pytest.warns(PackageWarning, match="facets.*adapter.*ZeroDivisionError"):
        assert detect(TWO_DTS) == "two_dts"


def test_errors_of_a_package_name_the_package(site: Path) -> None:
    asset = msb.export("facets.npz")
    (site / "msb_facets" / "native.py").write_text("import sys; sys.exit('no CUDA')\n")
    (site / "msb_facets" / "reference.py").write_text("def render(*_): 1 / 0\n")
    clear_caches()
    for tier, why in (
        ("dedicated", "native: the module cannot be loaded: SystemExit"),
        ("reference", "fails: ZeroDiv"),
    ):
        with pytest.raises(msb.MsbError, match=f"method facets of package msb_facets: .*{why}") as caught:
            msb.render(asset, CAMERA, tier=tier)
        assert (caught.value.code, caught.value.exit_status) == ("PACKAGE_LEFT_OUT", 2)


def test_a_method_without_roles_may_be_a_module(site: Path) -> None:
    (site / "msb_alone.py").write_text("from msb.registry import Method\nMETHOD = Method(title='Alone')\n")
    (site / "msb_facets-1.0.dist-info" / "entry_points.txt").write_text("[msb.methods]\nalone = msb_alone\n")
    clear_caches()
    assert METHODS["alone"].title == "Alone"
    assert detect(TWO_DTS) == "two_dts"
