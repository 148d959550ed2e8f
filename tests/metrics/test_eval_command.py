"""`msb eval` as its users meet it."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.metrics.vgg import weights_source
from tests.cli.conftest import Msb, msb
from tests.metrics.conftest import GOLDEN, golden, needs_torch

__all__ = ["msb"]  # the fixture
PRED, GT = GOLDEN / "pred", GOLDEN / "gt"
EXPECTED = ("smooth_plus_noise_37x53", "blurred_37x53", "identical_37x53")


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    return shutil.copytree(PRED, tmp_path / "pred"), shutil.copytree(GT, tmp_path / "gt")


def test_table(msb: Msb) -> None:
    result = msb("eval", PRED, GT)
    assert (result.status, result.err) == (0, "")
    lines = [line.split() for line in result.out.splitlines()]
    assert lines[:5] == [
        ["Image", "Size", "PSNR", "SSIM", "LPIPS"],
        ["r_0", "53x37", "33.84", "0.966", "--"],
        ["r_1", "53x37", "26.41", "0.851", "--"],
        ["r_2", "53x37", "inf", "1.000", "--"],
        ["mean", "of", "3", "images", "53.42", "0.939", "--"],
    ]
    assert "vgg16-397923af.pth" in result.out
    quiet = msb("eval", "-q", PRED, GT).out.splitlines()
    assert [line.split() for line in quiet] == [lines[0], lines[4]]


@pytest.mark.slow
def test_json_and_csv_hold_full_doubles(msb: Msb, tmp_path: Path) -> None:
    cases = {case["id"]: case for case in golden("psnr_ssim.json")["cases"]}
    result = msb("eval", "--json", "-", "--csv", tmp_path / "rows.csv", PRED, GT)
    data = result.json
    assert (data["schema"], data["count"], data["partial"]) == ("msb.eval/1", 3, False)
    for row, name in zip(data["images"], EXPECTED, strict=True):
        assert float(row["psnr"]) == pytest.approx(float(cases[name]["psnr"]), abs=1e-6)
        assert row["ssim"] == pytest.approx(cases[name]["ssim"], abs=1e-9)
        assert row["lpips"] is None
    finite = [cases[name]["psnr"] for name in EXPECTED[:2]]
    assert data["mean"]["psnr"] == pytest.approx((sum(finite) + 100) / 3, abs=1e-6)
    assert data["psnr_inf_count"] == 1
    assert data["lpips_reason"]
    assert [metric["name"] for metric in data["metrics"]] == ["psnr", "ssim"]
    rows = list(csv.DictReader((tmp_path / "rows.csv").read_text().splitlines()))
    assert float(rows[1]["psnr"]) == data["images"][1]["psnr"]
    assert (rows[2]["psnr"], rows[2]["lpips"]) == ("inf", "")
    again = msb("eval", "--csv", tmp_path / "rows.csv", PRED, GT)
    assert again.status == 2
    assert again.err.startswith("OUTPUT_EXISTS: ")


def test_two_files(msb: Msb) -> None:
    data = msb("eval", "--json", "-", PRED / "r_0.png", GT / "r_1.png").json
    assert data["count"] == 1
    assert data["images"][0]["name"] == "r_0"


@pytest.mark.slow
def test_every_bad_image_is_a_line_and_the_rest_is_compared(msb: Msb, folders: tuple[Path, Path]) -> None:
    pred, gt = folders
    (pred / "r_0.png").write_bytes((pred / "r_0.png").read_bytes()[:200])
    Image.fromarray(np.zeros((5, 5, 3), np.uint8)).save(gt / "r_2.png")
    result = msb("eval", "--json", "-", pred, gt)
    assert result.status == 3
    first, second = result.err.splitlines()
    assert first.startswith(f"METRIC_IMAGE: {pred / 'r_0.png'}: ")
    assert second.startswith(f"METRIC_SIZES_DIFFER: {pred / 'r_2.png'}: ")
    data = result.json
    assert (data["count"], data["partial"]) == (1, True)
    assert data["mean"]["psnr"] == data["images"][0]["psnr"]
    assert [failure["name"] for failure in data["failed"]] == ["r_0", "r_2"]
    assert "1 of 3 images" in msb("eval", pred, gt).out
    (pred / "r_1.npy").write_bytes(b"")
    alone = msb("eval", "--json", "-", pred, gt)
    assert (alone.status, alone.json["mean"]["psnr"], len(alone.err.splitlines())) == (3, None, 3)


@pytest.mark.slow
def test_missing_and_extra_images_are_named(msb: Msb, folders: tuple[Path, Path]) -> None:
    pred, gt = folders
    (pred / "r_1.npy").unlink()
    result = msb("eval", pred, gt)
    assert result.status == 3
    assert result.err.startswith(f"METRIC_IMAGE_NAMES: {pred}: r_1 ")
    assert msb("eval", "--subset", "--json", "-", pred, gt).json["count"] == 2


@pytest.mark.slow
def test_alpha_needs_a_background(msb: Msb, tmp_path: Path) -> None:
    red = np.zeros((20, 20, 4), np.uint8)
    red[..., 0], red[:10, :, 3] = 255, 255
    Image.fromarray(red).save(tmp_path / "a.png")
    over_white = np.where(red[..., 3:] > 0, red[..., :3], 255).astype(np.uint8)
    Image.fromarray(over_white).save(tmp_path / "b.png")
    result = msb("eval", tmp_path / "b.png", tmp_path / "a.png")
    assert result.status == 3
    assert result.err.startswith("METRIC_IMAGE_ALPHA: ")
    data = msb("eval", "--background", "white", "--json", "-", tmp_path / "b.png", tmp_path / "a.png").json
    assert data["images"][0]["psnr"] == "inf"
    assert data["background"] == [1, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("background", ["official", "mauve", "#12345", "2,0,0"])
def test_background_is_a_colour(msb: Msb, background: str) -> None:
    result = msb("eval", "--background", background, PRED, GT)
    assert result.status == 2
    assert result.err.startswith("USAGE: --background ")


@needs_torch
def test_lpips(msb: Msb, vgg_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    result = msb("eval", "--vgg-weights", vgg_file, "--json", file, PRED, GT, OMP_NUM_THREADS="1")
    assert result.status == 0
    assert result.err.startswith(f"warning: METRIC_VGG_UNKNOWN: {vgg_file}: ")
    data = json.loads(file.read_text())
    assert data["lpips_reason"] is None
    assert data["images"][2]["lpips"] == 0
    assert data["mean"]["lpips"] == pytest.approx(sum(row["lpips"] for row in data["images"]) / 3)
    assert data["warnings"] == [result.err.strip()]
    assert data["metrics"][2]["weights"]["vgg"]["sha256"]
    assert " ".join(result.out.split()).endswith(f"LPIPS: {weights_source(data['metrics'][2]['weights'])}")
    bad = msb("eval", "--vgg-weights", GT / "r_0.png", PRED, GT)
    assert bad.status == 3
    assert bad.err.startswith("METRIC_WEIGHTS: ")


def test_what_all_images_fail_by_is_said_once(msb: Msb, tmp_path: Path) -> None:
    for folder, size in (("pred", (8, 6)), ("gt", (16, 12))):
        (tmp_path / folder).mkdir()
        for number in range(3):
            Image.new("RGB", size).save(tmp_path / folder / f"{number}.png")
    result = msb("eval", tmp_path / "pred", tmp_path / "gt")
    assert result.status == 3
    (note,) = result.err.splitlines()[1:]
    assert note.startswith("note: 3 of 3 ")
