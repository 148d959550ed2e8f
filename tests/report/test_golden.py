"""The text of reports on the paper's numbers and on small synthetic results, compared with golden.md.

After an intended change of the text run `python -m tests.report.test_golden`, and read the difference.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from msb.bench.aggregate import SCENES
from msb.bench.documents import ChamferDocument
from msb.bench.records import Cell, Floor, Training, WalkDocument
from msb.report.build import build_report, paper_report
from msb.report.report import Report
from msb.report.results import read_results
from msb.report.writers import to_markdown
from tests.report.factory import METRICS, WALK, at_rate, bake, chamfer, measure, quality, write, write_results

GOLDEN = Path(__file__).with_name("golden.md")
GPU: dict[str, Any] = {"device": {"device": {"name": "Another GPU", "platform": "Vulkan"}}}


def benchmark(root: Path) -> tuple[str, ...]:
    write_results(root, datasets=["tanksandtemples"])
    return ("gaps-tanksandtemples", "slowdown", "native_summary")


def not_monotone(root: Path) -> tuple[str, ...]:
    for condition, psnr in (("non_engine", 20.0), ("dedicated", 22.0), ("standard", 15.0)):
        measure(root, condition, psnr)
    return ("gaps-capture",)


def rounds_to_nothing(root: Path) -> tuple[str, ...]:
    for condition, psnr in (("non_engine", 30.0), ("dedicated", 30.004), ("standard", 20.0)):
        measure(root, condition, psnr)
    return ("gaps-capture",)


def a_scene_is_missing(root: Path) -> tuple[str, ...]:
    """Dedicated has 20 and 40 dB on two scenes. Standard has 15 dB on one scene and fails on the other."""
    garden: dict[str, Any] = {"dataset": "mipnerf360", "scene": "garden"}
    measure(root, "dedicated", 20.0, **garden)
    measure(root, "standard", 15.0, shifts=(-0.4, 0.0, 0.4), **garden)
    bonsai = {**garden, "scene": "bonsai"}
    measure(root, "dedicated", 40.0, **bonsai)
    measure(root, "standard", **bonsai, status="failed", quality=None, timing=None)
    measure(root, "standard", **garden, method="diffsoup")
    return ("gaps-mipnerf360", "renderer_comparison-mipnerf360", "scenes-mipnerf360-standard")


def images_and_surfaces(root: Path) -> tuple[str, ...]:
    for method, psnr, ssim, overall, minutes in (
        ("two_dts", 31.0, 0.9, 0.8, 20),
        ("mesh_splatting", 29.0, 0.8, 0.5, 40),
    ):
        for scene in ("desk", "chair"):
            distance = ChamferDocument.of(chamfer(overall))
            training = {"seconds": minutes * 60.0}
            named = {"method": method, "scene": scene}
            measure(root, "non_engine", psnr, ssim, **named, chamfer=distance, training=training)
    return ("native_summary",)


def images_and_cost(root: Path, kind: str = "gpu") -> tuple[str, ...]:
    for method, psnr, fps in (("two_dts", 31.0, 50.0), ("mesh_splatting", 29.0, 400.0)):
        timing = {**at_rate(fps), "device_kind": kind}
        memory = {"geometry": 300 << 20 if method == "two_dts" else 200 << 20}
        measure(root, "dedicated", psnr, method=method, timing=timing, memory=memory)
    return ("scenes-capture-dedicated", "latency-capture")


def images_and_cost_on_a_cpu(root: Path) -> tuple[str, ...]:
    tables = images_and_cost(root, "cpu")
    for method, psnr in (("two_dts", 31.0), ("mesh_splatting", 29.0)):
        measure(root, "non_engine", psnr, method=method)
    return tables


def trained_on_the_test_views(root: Path) -> tuple[str, ...]:
    text = "it was trained on the test views (eval=False): its numbers on them are not comparable"
    for method in ("two_dts", "triangle_splatting"):
        for condition in ("non_engine", "dedicated", "standard"):
            measure(root, condition, method=method, trained=(text,) if method == "two_dts" else ())
    return ("native_summary", "renderer_comparison-capture", "scenes-capture-standard")


def notes(root: Path) -> tuple[str, ...]:
    """Results with footnotes: a reference renderer, other photographs, LPIPS weights, opacity thresholds."""
    vgg = {"file": "v.npz", "sha256": "ab" * 32, "known": None}
    lpips = {"name": "lpips_vgg", "weights": {"vgg": vgg, "heads": {"known": "lpips 0.1.4"}}}
    with_lpips = {"metrics": (*METRICS, lpips)}
    for method, folder, kind, seconds in (
        ("two_dts", "images_2", "msb_reference", 1.2),
        ("triangle_splatting", "images_2", "upstream", 2.4),
        ("mesh_splatting", "images_4", "upstream", 90.0),
    ):
        parts: dict[str, Any] = {"method": method, "setup": {"image_folder": folder}, "quality": with_lpips}
        renderer: dict[str, Any] = {"settings": {"ste_threshold": 0.1}}
        native = {**renderer, "kind": kind}
        measure(root, "non_engine", **parts, renderer=native, training={"seconds": seconds})
        for condition in ("dedicated", "standard"):
            measure(root, condition, **parts, renderer=renderer)
    return ("native_summary", "renderer_comparison-capture")


def floors(root: Path) -> tuple[str, ...]:
    """A single triangle takes 30 and 50 MiB on two scenes."""
    for dataset in ("tanksandtemples", "capture"):
        for scene, size in (("train", 30 << 20), ("truck", 50 << 20)):
            floor = Floor(width=980, height=545, p50_ms=0.5, p95_ms=0.7, memory_bytes=size)
            measure(root, "standard", dataset=dataset, scene=scene, floor=floor)
        measure(root, "dedicated", dataset=dataset, scene="train")
    return ("memory-capture", "latency-capture", "runtime_resources-tanksandtemples")


def metrics_of_the_model(root: Path) -> tuple[str, ...]:
    """One method has Chamfer distances and training times but no images; another method has none of these."""
    trained = Training(seconds=1500.0, peak_memory_bytes=None, source="track.json")
    for scene in SCENES["dtu"]:
        distance = ChamferDocument.of(chamfer(0.75))
        measure(root, "exported_mesh", dataset="dtu", scene=scene, chamfer=distance, training=trained)
    measure(root, "exported_mesh", dataset="dtu", scene=SCENES["dtu"][0], method="mesh_splatting")
    return ("native_summary", "scenes-dtu-non_engine")


def walks(root: Path) -> tuple[str, ...]:
    for condition, flicker, holes in (("dedicated", 1.25, 0.01), ("standard", 3.5, 0.002)):
        measure(root, condition, 20.0, walk=WalkDocument.of(WALK | {"flicker": flicker, "holes": holes}))
    return ("walk-capture",)


def engines(root: Path) -> tuple[str, ...]:
    measure(root, "non_engine", 30.0)
    measure(root, "dedicated", 30.0, timing=at_rate(50.0))
    measure(root, "standard", 20.0, timing=at_rate(100.0))
    engine = {"renderer": "wgpu"}
    measure(root, "standard", 18.0, cell=engine, timing=at_rate(900.0), **GPU)
    for label, psnr, fps in (("hardware", 29.0, 300.0), ("coarse", 27.0, 450.0)):
        blends = {"device": {"device": {**GPU["device"]["device"], "blends": "float32"}}}
        measure(root, "dedicated", psnr, cell={**engine, "variant": label}, timing=at_rate(fps), **blends)
    return ("slowdown", "gaps-capture", "renderer_comparison-capture")


def bakes(root: Path) -> tuple[str, ...]:
    """2DTS on one scene: Dedicated 30 dB, Standard 18 dB, ceiling 21.5 dB, fitted triangles 27 dB."""
    desk = Cell(dataset="capture", scene="desk", method="two_dts", condition="standard")
    for condition, psnr in {"non_engine": 30.2, "dedicated": 30.0, "standard": 18.0}.items():
        measure(root, condition, psnr)
    measure(root, "exported_mesh")
    for label, geometry, psnr in (("ceiling", "kept", 21.5), ("fitted", "fitted", 27.0)):
        record = measure(root, "standard", psnr)
        parts = bake(label, geometry, source_cell=desk, faces=1234, seconds=12.0)
        parts["quality"] = quality(psnr, cell=parts["cell"])
        write(root, record.model_copy(update=parts))
    measure(root, "standard", 18.0)
    return ("loss_split-capture", "bakes-capture", "gaps-capture")


def another_background(root: Path) -> tuple[str, ...]:
    measure(root, "non_engine")
    measure(root, "dedicated", setup={"background": (1.0, 1.0, 1.0)})
    return ("gaps-capture",)


def equal_at_the_printed_digits(root: Path) -> tuple[str, ...]:
    """One method leads in SSIM. In PSNR both methods are equal at the printed precision."""
    for method, psnr, ssim in (("two_dts", 30.0, 0.8), ("mesh_splatting", 30.004, 0.9)):
        measure(root, "non_engine", psnr, ssim, method=method)
    return ("native_summary",)


def compare(root: Path, scenes: Sequence[str], method: str, *psnr: float, **changes: Any) -> None:
    """Write a record of three views per scene; `psnr` are the means of the scenes, in dB."""
    for scene, mean in zip(scenes, psnr, strict=True):
        shifts = np.random.default_rng(len(method + scene) + round(mean)).normal(0, 0.3, 3)
        shifts = tuple(shifts - shifts.mean())
        measure(root, "standard", mean, shifts=shifts, method=method, scene=scene, **changes)


def against_over_scenes(root: Path) -> tuple[str, ...]:
    """Methods that cannot be compared: a missing scene, another background, other photographs."""
    scenes = ("desk", "chair", "room", "hall")
    compare(root, scenes, "mesh_splatting", 24.0, 25.0, 26.0, 27.0)
    compare(root, scenes[1:], "two_dts", 25.6, 26.7, 27.8)
    white = {"camera_convention": "full_K", "background": (1.0, 1.0, 1.0)}
    compare(root, scenes, "triangle_splatting", 25.0, 26.0, 27.0, 28.0, setup=white)
    compare(root, scenes, "ours", 25.0, 26.0, 27.0, 28.0, setup={"image_folder": "images_8"})
    return ("against",)


def against_on_one_scene(root: Path) -> tuple[str, ...]:
    compare(root, ["desk"], "mesh_splatting", 24.0)
    compare(root, ["desk"], "two_dts", 21.0)
    return ("against",)


CASES: tuple[Callable[[Path], tuple[str, ...]], ...] = (
    benchmark,
    not_monotone,
    rounds_to_nothing,
    a_scene_is_missing,
    images_and_surfaces,
    images_and_cost,
    images_and_cost_on_a_cpu,
    trained_on_the_test_views,
    notes,
    floors,
    metrics_of_the_model,
    walks,
    engines,
    bakes,
    another_background,
    equal_at_the_printed_digits,
    against_over_scenes,
    against_on_one_scene,
)
"""Functions that write results and return the labels of the tables to print."""


def print_report(title: str, report: Report, tables: tuple[str, ...]) -> Iterator[str]:
    yield f"# {title}"
    yield from report.notes
    yield from (f"{finding.kind} ({finding.table}): {finding.sentence}" for finding in report.findings)
    for verdict in dict.fromkeys((*report.verdicts[:1], *report.verdicts[-1:])):
        yield f"## {'/'.join(verdict.place)}"
        yield from (f"{statement.use}: {statement.mark}. {statement.why}" for statement in verdict.statements)
    yield from (to_markdown(report.tables[label]) for label in tables)


def text() -> str:
    """Return the text of golden.md."""
    parts = [*print_report("paper", paper_report(pictures=False), ("slowdown",))]
    for case in CASES:
        with TemporaryDirectory() as folder:
            root = Path(folder, "results")
            tables = case(root)
            results = read_results(root, allow_mixed=case is another_background)
            against = "mesh_splatting" if "against" in tables else None
            report = build_report(results, pictures=False, with_paper=False, against=against)
            parts += (
                part.replace(str(root), "RESULTS") for part in print_report(case.__name__, report, tables)
            )
    return "\n\n".join(parts) + "\n"


@pytest.mark.slow
def test_text_of_reports_is_unchanged() -> None:
    assert text() == GOLDEN.read_text("utf-8")


if __name__ == "__main__":
    GOLDEN.write_text(text(), "utf-8")
