"""Findings on more than PSNR: who leads by what, what training costs, and what is too small to be said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from msb.bench.documents import ChamferDocument
from msb.bench.records import Training
from msb.report.collect import collect
from msb.report.findings import find
from msb.report.results import read_results
from tests.report.documents import chamfer
from tests.report.factory import make_result, quality, write


def test_images_and_surface_may_have_other_leaders(tmp_path: Path) -> None:
    for method, psnr, ssim, overall, minutes in (
        ("two_dts", 31.0, 0.9, 0.8, 20),
        ("mesh_splatting", 29.0, 0.8, 0.5, 40),
    ):
        for scene in ("desk", "chair"):
            made = make_result("capture", scene, method, "non_engine")
            changes: dict[str, Any] = {
                "quality": quality(made.cell, psnr, ssim, None),
                "chamfer": ChamferDocument.of(chamfer(overall)),
                "training": Training(seconds=minutes * 60.0, peak_memory_bytes=None, source="x"),
            }
            write(tmp_path, made.model_copy(update=changes))
    found = {one.kind: one.sentence for one in find(collect(read_results(tmp_path)))}
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
        made = make_result("capture", "desk", method, "non_engine")
        write(tmp_path, made.model_copy(update={"quality": quality(made.cell, psnr, ssim, None)}))
    assert "leaders" not in {one.kind for one in find(collect(read_results(tmp_path)))}
