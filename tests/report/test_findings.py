"""Findings on more than PSNR: who leads by what, what training costs, and what is too small to be said."""

from __future__ import annotations

from pathlib import Path

import pytest

from msb.bench.documents import ChamferDocument
from msb.report.findings import find
from tests.report.documents import chamfer
from tests.report.factory import measure, numbers_of


def test_images_and_surface_may_have_other_leaders(tmp_path: Path) -> None:
    for method, psnr, ssim, overall, minutes in (
        ("two_dts", 31.0, 0.9, 0.8, 20),
        ("mesh_splatting", 29.0, 0.8, 0.5, 40),
    ):
        for scene in ("desk", "chair"):
            distance = ChamferDocument.of(chamfer(overall))
            training = {"seconds": minutes * 60.0}
            named = {"method": method, "scene": scene}
            measure(tmp_path, "non_engine", psnr, ssim, **named, chamfer=distance, training=training)
    found = {one.kind: one.sentence for one in find(numbers_of(tmp_path))}
    assert found["leaders"] == (
        "No method leads by every metric: on capture (Non-Engine) 2DTS by PSNR 31.00 dB and SSIM 0.900, "
        "MeshSplatting by CD 0.50 mm."
    )
    assert found["training"] == (
        "A training takes from 20.0 min (2DTS on capture) to 40.0 min (MeshSplatting on capture)."
    )


@pytest.mark.parametrize("apart", [0.0, 0.004])
def test_nobody_leads_by_less_than_a_table_shows(tmp_path: Path, apart: float) -> None:
    for method, psnr, ssim in (("two_dts", 30.0, 0.8), ("mesh_splatting", 30.0 + apart, 0.9)):
        measure(tmp_path, "non_engine", psnr, ssim, method=method)
    assert "leaders" not in {one.kind for one in find(numbers_of(tmp_path))}
