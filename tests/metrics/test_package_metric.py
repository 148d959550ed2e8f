"""The image metric of docs/extending.md in a separate package: a valid one, a failing one, and one with
invalid fields.
"""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from msb.base.packages import PackageWarning
from msb.metrics import IMAGE_METRICS, METRICS, Measures, registry
from tests.cli.conftest import msb
from tests.test_docs_commands import install_example

__all__ = ["msb"]
OURS = ["psnr", "ssim", "lpips"]
BLACK, WHITE = np.zeros((4, 4, 3)), np.ones((4, 4, 3))


def forget() -> None:
    registry._installed.cache_clear()
    sys.modules.pop("msb_edges", None)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    return install_example("docs/extending.md", tmp_path / "site")


@pytest.fixture
def edit(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Install the metric with a replaced part of its text or of its entry point."""
    monkeypatch.syspath_prepend(site)

    def change(old: str = "", new: str = "", entry: str = "edges = msb_edges:EDGES") -> None:
        file = site / "msb_edges.py"
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new) if old else text)
        (site / "msb_edges-1.0.dist-info" / "entry_points.txt").write_text(f"[msb.metrics]\n{entry}\n")
        forget()

    yield change
    monkeypatch.undo()
    forget()


def test_package_metric_is_registered(edit: Callable[..., None]) -> None:
    edit()
    assert list(IMAGE_METRICS) == [*OURS, "edges"]
    assert METRICS["edges"] == "lower"
    measures = Measures()
    assert measures(BLACK, BLACK)["edges"] == 0
    ramp = np.linspace(0, 255, 4).round()[:, None, None] / 255 * np.ones((4, 4, 3))
    assert measures(ramp, BLACK)["edges"] == pytest.approx(1 / 6)
    assert measures.identities[-1].to_dict()["libraries"]["msb-edges"] == "1.0"
    assert measures.failed == {}


FAILING = {
    "raise SystemExit": "SystemExit",
    "return float('nan')": "nan",
    "return None": "TypeError",
}


@pytest.mark.parametrize(("text", "why"), FAILING.items())
def test_failing_package_metric_is_none_and_named(edit: Callable[..., None], text: str, why: str) -> None:
    edit("    steps = [", f"    {text}\n    steps = [")
    measures = Measures()
    values = measures(WHITE, BLACK)
    assert (values["psnr"], values["edges"]) == (0, None)
    assert re.match(f"METRIC_FAILED: .*msb_edges .*{why}", measures.failed["edges"])


def test_package_metric_cannot_print_or_change_images(
    edit: Callable[..., None], capfd: pytest.CaptureFixture[str]
) -> None:
    edit("    steps = [", "    print('hello')\n    rendering[:] = 1\n    steps = [")
    image = WHITE * 0.2
    assert Measures()(image, BLACK)["edges"] == 0
    assert image.max() == 0.2
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("old", "new", "entry", "why"),
    [
        ("EDGES = ", "EDGES = 3\nOTHER = ", None, "ImageMetric, .* int"),
        ("", "", "psnr = msb_edges:EDGES", "msb.metrics"),
        ("", "", "fps = msb_edges:EDGES", "records"),
        ("", "", "corners = msb_edges:EDGES", "corners"),
        ("decimals=4", "decimals='4'", None, "decimals"),
        ('better="lower"', 'better="less"', None, "'less'"),
    ],
)
def test_invalid_package_metric_gives_one_warning(
    edit: Callable[..., None], old: str, new: str, entry: str | None, why: str
) -> None:
    edit(old, new, **({} if entry is None else {"entry": entry}))
    with pytest.warns(PackageWarning, match=f"^PACKAGE_LEFT_OUT: .*{why}") as caught:
        assert list(IMAGE_METRICS) == OURS
    assert len(caught) == 1
