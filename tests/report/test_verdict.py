"""The verdict on an asset: what it is good for, and by which numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.bench.folder import Results
from msb.report.report import Report
from msb.report.results import Place
from msb.report.verdict import Likeness
from tests.report.factory import VIEWS, measure, note_hashes, verdict_of

PLAIN, SHADED = "A plain mesh in any engine (Standard)", "A model with its own shaders (Dedicated)"
EDITING = "Editing: subdivision, collision, UV unwrapping, printing"


def test_verdict_says_what_the_asset_is_good_for(report: Report) -> None:
    (verdict,) = [one for one in report.verdicts if one.place == Place("tanksandtemples", "train", "two_dts")]
    said = {one.use: one for one in verdict.statements}
    plain = said[PLAIN]
    assert plain.mark == "NO"
    assert plain.why.startswith("Looks different from its own renderer: ")
    assert plain.why.endswith("to the photographs it loses 10.74 dB (PSNR 22.83 to 12.09 dB).")
    assert said["Real time, Standard"].mark == "YES"
    assert said[EDITING].mark == "NO"
    assert "65 % of its vertices are non-manifold" in said[EDITING].why
    assert said["Size on disk"].why == "343 MiB, the same for both."
    (soup,) = [one for one in report.verdicts if one.place == Place("tanksandtemples", "train", "diffsoup")]
    said = {one.use: one for one in soup.statements}
    assert said[PLAIN].mark == "NO"
    assert said[PLAIN].why.startswith("Not supported: its colours come")
    assert said[SHADED].mark == "YES"
    assert "Real time, Standard" not in said


def test_a_training_on_the_test_views_is_noted(tmp_path: Path) -> None:
    measure(tmp_path, "dedicated", trained=("it was trained on the test views",))
    noted = verdict_of(tmp_path)["Training"]
    assert (noted.mark, noted.why) == ("NOTE", "It was trained on the test views.")


@pytest.mark.parametrize(("loss", "mark"), [(-0.2, "YES"), (0.99, "YES"), (1.0, "WITH CARE"), (3.0, "NO")])
def test_looks_follow_the_loss_and_say_what_they_are_held_against(
    tmp_path: Path, loss: float, mark: str
) -> None:
    measure(tmp_path, "non_engine", 20.0, renderer={"kind": "msb_reference"})
    measure(tmp_path, "dedicated", 20.0 - loss)
    said = verdict_of(tmp_path)
    dedicated = said[SHADED]
    assert dedicated.mark == mark
    assert "our reference of its own renderer" in dedicated.why
    assert f"{abs(loss):.2f} dB (PSNR 20.00 to {20 - loss:.2f} dB)" in dedicated.why
    assert said[PLAIN].why == "Not known: not run."


@pytest.mark.parametrize(
    ("noise", "psnr", "mark", "said"),
    [
        (0, (30.0, 30.0), "YES", "Looks as in its own renderer: 100.0 dB between the two renderings"),
        (2, (30.0, 30.0), "YES", "Looks as in its own renderer: 4"),
        (9, (30.0, 34.0), "WITH CARE", "to the photographs it gains 4.00 dB"),
        (60, (30.0, 30.0), "NO", "Looks different from its own renderer: 1"),
        (60, (6.71, 7.26), "UNKNOWN", "is at 6.71 dB to the photographs, too far to judge others by it"),
        (0, (30.0, 20.0), "YES", "loses 10.00 dB"),
        (0, (30.0, 30.001), "YES", "to the photographs it loses nothing (PSNR 30.00 to 30.00 dB)"),
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
    assert "in the dedicated tier: " in plain.why
    assert ("dB between the two renderings" in plain.why) is pictures
    assert plain.why.endswith(
        "loses 1.50 dB (PSNR 30.00 to 28.50 dB). Held against the dedicated tier of this run, as the "
        "protocol has no images of the official renderer."
    )
    dedicated = said[SHADED]
    assert (dedicated.mark, dedicated.why) == (
        "UNKNOWN",
        "PSNR 30.00 dB; the protocol has no images of the official renderer, so there is nothing to judge it "
        "by.",
    )


@pytest.mark.parametrize(
    ("p95", "kind", "mark"),
    [
        (16.0, "gpu", "YES"),
        (16.0, "cpu", "YES"),
        (20.0, "gpu", "WITH CARE"),
        (40.0, "gpu", "NO"),
        (40.0, "cpu", "UNKNOWN"),
    ],
)
def test_real_time_follows_the_p95(tmp_path: Path, p95: float, kind: str, mark: str) -> None:
    measure(tmp_path, "dedicated", timing={"p95_ms": p95, "device_kind": kind})
    said = verdict_of(tmp_path)["Real time, Dedicated"]
    assert said.mark == mark
    assert f"{p95:.1f} ms" in said.why


@pytest.mark.parametrize(
    ("p95", "mark", "said"),
    [
        (16.66, "YES", "16.66"),
        (16.69, "WITH CARE", "16.69"),
        (33.24, "WITH CARE", "33.2"),
        (33.34, "NO", "33.34"),
    ],
)
def test_a_time_is_not_printed_as_a_limit_that_it_misses(
    tmp_path: Path, p95: float, mark: str, said: str
) -> None:
    measure(tmp_path, "dedicated", timing={"p95_ms": p95, "device_kind": "gpu"})
    found = verdict_of(tmp_path)["Real time, Dedicated"]
    assert (found.mark, f"at most {said} ms (" in found.why) == (mark, True), found


def test_a_likeness_just_below_a_limit_is_not_printed_as_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for condition in ("non_engine", "dedicated"):
        measure(tmp_path, condition, 30.0)
    monkeypatch.setattr("msb.report.verdict.likeness", lambda *_: Likeness(34.96, 3, 3))
    found = verdict_of(tmp_path)[SHADED]
    assert (found.mark, "34.9 dB between the two renderings" in found.why) == ("WITH CARE", True), found
