"""Where the paper contradicts itself, in its prose or between its tables: notes under its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from msb.report.table import Table

CONTRADICTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "native_summary": (
            "section 4.1 names DiffSoup the fastest to train; on DTU this table has MeshSplatting (10.7 "
            "min) and Triangle-Splatting (13.1 min) before it (14.5 min)",
        ),
        "mip360_renderer_comparison": (
            "section 4.2 says that 2DTS and Triangle-Splatting lead under Dedicated; by PSNR DiffSoup is "
            "second (23.15 dB, between 23.28 and 22.96)",
            "2DTS is drawn at 545 frames a second under Dedicated, which its GPU time does not allow (P50 "
            "2.1 ms): the two must be of separate runs",
        ),
        "mip360_unity_gpu_latency": (
            "section 4.2 has P95 within 0.2 ms of P50; the means of Triangle-Splatting and MeshSplatting "
            "are 0.2 ms apart, and its scenes up to 0.5 ms (counter)",
        ),
        "tnt_renderer_comparison": (
            "the appendix speaks of a strong performance of DiffSoup here; it is the last by PSNR, SSIM "
            "and LPIPS, and the first by frame rate and training time alone",
        ),
        "reproducibility_comparison": (
            "the same mean difference of 0.075 dB is said of 27 pairs in section 4 and of 33 pairs in the "
            "appendix",
            "the appendix bounds the differences by 0.35 dB and by 0.8 %; 0.8 % of a PSNR of 22 to 33 dB "
            "is 0.18 to 0.26 dB",
            "the appendix has three methods within 0.05 dB of what was published on Tanks and Temples; "
            "Triangle-Splatting is 0.06 dB off",
        ),
        "feature_mapping": (
            "DiffSoup's depth sort under Dedicated can only be a depth test: it has no alpha compositing",
        ),
        "method_attributes": (
            "MeshSplatting composites alpha by this table, and by the introduction only 2DTS and Triangle-"
            "Splatting do: its vertices have opacity in training, and are opaque in the end",
        ),
        "slowdown": (
            "the abstract has 6 to 30 times, section 4.2 has 6.0 to 32.8: the latter are the means of Mip-"
            "NeRF 360; on Tanks and Temples the least is 5.1",
            "the abstract's slowdown is Standard over Dedicated; against Non-Engine, Dedicated is the "
            "faster one for 2DTS, DiffSoup and MeshSplatting",
        ),
        "gaps-mipnerf360": (
            "section 4.2 gives 15.64 dB as 2DTS's loss on bonsai, which is to the last digit its gap of "
            "the whole dataset",
            "the paper calls the three gaps orthogonal and the third the sum of the others: two are "
            "independent, and the sum holds only where Dedicated lies between the others",
        ),
    }
)
"""Label of a table of the paper's report -> what is known to contradict it."""


def with_contradictions(table: Table) -> Table:
    """Return a table of the paper's with notes on what contradicts it elsewhere in the paper."""
    return replace(table, notes=(*table.notes, *CONTRADICTIONS.get(table.label, ())))
