"""The verdict on an asset: what it is good for, and by which numbers."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.bench.folder import Results
from msb.report.verdict import Likeness
from tests.report.factory import VIEWS, measure, note_hashes, verdict_of

PLAIN, SHADED = "A plain mesh in any engine (Standard)", "A model with its own shaders (Dedicated)"


def test_a_training_on_the_test_views_is_noted(tmp_path: Path) -> None:
    measure(tmp_path, "dedicated", trained=("it was trained on the test views",))
    noted = verdict_of(tmp_path)["Training"]
    assert noted.mark == "NOTE"


@pytest.mark.parametrize(("loss", "mark"), [(-0.2, "YES"), (0.99, "YES"), (1.0, "WITH CARE"), (3.0, "NO")])
def test_looks_follow_the_loss_and_say_what_they_are_held_against(
    tmp_path: Path, loss: float, mark: str
) -> None:
    measure(tmp_path, "non_engine", 20.0, renderer={"kind": "msb_reference"})
    measure(tmp_path, "dedicated", 20.0 - loss)
    said = verdict_of(tmp_path)
    dedicated = said[SHADED]
    assert dedicated.mark == mark
    assert f"{abs(loss):.2f} dB" in dedicated.why
    assert said[PLAIN].mark == "UNKNOWN"


@pytest.mark.parametrize(
    ("noise", "psnr", "mark", "said"),
    [
        (0, (30.0, 30.0), "YES", ": 100.0 dB"),
        (2, (30.0, 30.0), "YES", ": 4"),
        (9, (30.0, 34.0), "WITH CARE", "gains 4.00 dB"),
        (60, (30.0, 30.0), "NO", ": 1"),
        (60, (6.71, 7.26), "UNKNOWN", "6.71 dB"),
        (0, (30.0, 20.0), "YES", "loses 10.00 dB"),
        (0, (30.0, 30.001), "YES", "loses nothing"),
    ],
)
def test_looks_are_those_of_the_two_renderings(
    tmp_path: Path, noise: int, psnr: tuple[float, float], mark: str, said: str
) -> None:
    random = np.random.default_rng(3)
    picture = random.integers(70, 180, (64, 96, 3))
    for condition, value, change in zip(("non_engine", "dedicated"), psnr, (0, noise), strict=True):
        made = measure(tmp_path, condition, value)
        file = Results(tmp_path).record(made.cell)
        for name in VIEWS:
            place = (file.parent / "images" / name).with_suffix(".png")
            place.parent.mkdir(parents=True, exist_ok=True)
            changed = picture + random.integers(-change, change + 1, picture.shape)
            Image.fromarray(changed.astype(np.uint8)).save(place)
        note_hashes(file)
    dedicated = verdict_of(tmp_path)[SHADED]
    assert (dedicated.mark, said in dedicated.why) == (mark, True), dedicated


@pytest.mark.parametrize("pictures", [True, False])
def test_without_the_own_renderer_standard_is_held_against_dedicated(tmp_path: Path, pictures: bool) -> None:
    for condition, psnr in (("dedicated", 30.0), ("standard", 28.5)):
        measure(tmp_path, condition, psnr, images=pictures)
    said = verdict_of(tmp_path)
    plain = said[PLAIN]
    assert plain.mark == "WITH CARE"
    assert ("between the two renderings" in plain.why) is pictures
    assert "loses 1.50 dB" in plain.why
    assert said[SHADED].mark == "UNKNOWN"


@pytest.mark.parametrize(
    ("p95", "kind", "mark", "printed"),
    [
        (16.66, "gpu", "YES", "16.66"),
        (16.69, "gpu", "WITH CARE", "16.69"),
        (33.24, "gpu", "WITH CARE", "33.2"),
        (33.34, "gpu", "NO", "33.34"),
        (16.0, "cpu", "YES", "16.0"),
        (40.0, "cpu", "UNKNOWN", "40.0"),
    ],
)
def test_real_time_follows_the_p95_and_no_time_is_printed_as_a_limit_that_it_misses(
    tmp_path: Path, p95: float, kind: str, mark: str, printed: str
) -> None:
    measure(tmp_path, "dedicated", timing={"p95_ms": p95, "device_kind": kind})
    said = verdict_of(tmp_path)["Real time, Dedicated"]
    assert said.mark == mark
    assert f"{printed} ms" in said.why


def test_a_likeness_just_below_a_limit_is_not_printed_as_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for condition in ("non_engine", "dedicated"):
        measure(tmp_path, condition, 30.0)
    monkeypatch.setattr("msb.report.verdict.likeness", lambda *_: Likeness(34.96, 3, 3))
    found = verdict_of(tmp_path)[SHADED]
    assert (found.mark, "34.9 dB between" in found.why) == ("WITH CARE", True), found
