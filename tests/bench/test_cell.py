"""One cell is computed in this process: LPIPS, engines, internal errors, and the kept parts of a record."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.bench import cell as cells
from msb.bench import parts
from msb.bench.cell import compute
from msb.bench.folder import Results, lock_results
from msb.bench.inputs import InputReader
from msb.bench.job import Job, JobOutcome, PartName
from msb.bench.models import prepare_model
from msb.bench.photographs import PhotographTask, write_photographs
from msb.bench.plan import Planned, Planner, find_pairs
from msb.bench.protocol import ProtocolFile
from msb.bench.records import Reason, read_result
from msb.metrics import registry
from msb.render.backend import renderers
from msb.render.frame import Frame
from msb.render.images import image_names
from tests.bench.protocols import change_tables, make_protocol
from tests.report.factory import timing


class Bench:
    """Runs the stages of a run in this process, one cell at a time."""

    def __init__(self, file: ProtocolFile, run: str) -> None:
        self.file, self.run = file, run

    def plan(self, only: str, *, redo: bool = False) -> Planned:
        """Return the plan of the one cell that `only` selects."""
        pairs = find_pairs(self.file)
        models: dict[Any, Any] = {
            pair: prepare_model(pair.task(self.file.results, self.run)) for pair in pairs
        }
        (planned,) = Planner(self.file, self.run, InputReader(), [only], redo=redo).plan(pairs, models)
        return planned

    def job(self, only: str) -> Job:
        """Return the job that computes all parts of a cell, whose ground truth has been written."""
        job = self.plan(only, redo=True).job
        write_photographs(PhotographTask(self.file.results, self.run, job.scene, job.views))
        return job

    def compute(self, only: str, *names: str) -> JobOutcome:
        job = self.job(only)
        return compute(replace(job, parts={part: job.parts[part] for part in names}))

    def record(self, done: JobOutcome) -> Any:
        return read_result(Results(self.file.results).record(done.cell))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    file = make_protocol(tmp_path, ("mesh_splatting",))
    with lock_results(file.results) as run:
        yield Bench(file, run)


@pytest.fixture
def measures(monkeypatch: pytest.MonkeyPatch) -> dict[PartName, Any]:
    """The functions that compute parts.

    The functions for images and timings are fakes that return at once.
    """
    monkeypatch.setitem(cells.MEASURES, "quality", lambda _: {"device": {}})
    monkeypatch.setitem(cells.MEASURES, "timing", lambda _: {"timing": timing()})
    return cells.MEASURES


class FakeNetwork:
    """Replaces the network of LPIPS by the mean absolute difference, which needs no weights."""

    weights = {  # noqa: RUF012
        "vgg": {"file": "vgg.pth", "sha256": "0" * 64, "known": None},
        "heads": {"known": None},
    }
    warnings = ()

    def __call__(self, pred: Any, gt: Any) -> float:
        return float(np.abs(pred - gt).mean())


@pytest.fixture
def fake_network(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = replace(registry.IMAGE_METRICS["lpips"], load=lambda _path: FakeNetwork())
    monkeypatch.setattr(registry, "IMAGE_METRICS", {**registry.IMAGE_METRICS, "lpips": metric})


@pytest.mark.slow
def test_lpips_is_measured_if_weights_are_given(bench: Bench, tmp_path: Path, fake_network: None) -> None:
    bench.file = change_tables(bench.file, metrics={"vgg_weights": "vgg.pth"})
    assert bench.job("standard").vgg_weights == tmp_path / "vgg.pth"
    quality = bench.record(bench.compute("standard", "quality")).quality
    assert quality.lpips == pytest.approx(np.mean([image.lpips for image in quality.images]))
    assert quality.lpips > 0.005
    assert quality.lpips_reason is None
    assert [metric["name"] for metric in quality.metrics] == ["psnr", "ssim", "lpips_vgg"]
    assert quality.metrics[2]["weights"]["vgg"]["sha256"] == "0" * 64
    bench.file = change_tables(bench.file, metrics={"vgg_weights": None})
    assert bench.plan("standard").why["quality"] == "metrics changed"


@pytest.mark.slow
def test_an_internal_error_loses_one_part_only(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_job: Job) -> dict[str, Any]:
        raise KeyError("what")

    monkeypatch.setitem(cells.MEASURES, "timing", broken)
    done = bench.compute("dedicated", "quality", "timing")
    record = bench.record(done)
    assert (done.status, record.status) == ("done", "done")
    assert record.quality is not None
    assert record.reasons["timing"].code == "INTERNAL"
    monkeypatch.setitem(cells.MEASURES, "quality", broken)
    done = bench.compute("dedicated", "quality")
    record = bench.record(done)
    assert (done.status, record.reason.code, record.quality) == ("failed", "INTERNAL", None)


@pytest.mark.slow
def test_a_timing_keeps_the_images_and_vice_versa(bench: Bench) -> None:
    first = bench.record(bench.compute("dedicated", "quality"))
    second = bench.record(bench.compute("dedicated", "timing"))
    assert (second.quality, second.setup, second.renderer) == (first.quality, first.setup, first.renderer)
    assert second.timing is not None
    assert second.seconds > first.seconds
    third = bench.record(bench.compute("dedicated", "quality"))
    assert (third.timing, third.memory, third.device) == (second.timing, second.memory, second.device)
    assert second.floor == third.floor
    assert 0 < second.floor.memory_bytes < second.memory.total
    image = first.quality.images[0]
    assert (second.floor.width, second.floor.height) == (image.width, image.height)
    assert set(third.inputs) == {"quality", "timing"}


def test_a_new_asset_gets_no_numbers_of_the_old_one(bench: Bench, measures: dict[PartName, Any]) -> None:
    """The run on the new asset ends before its timing, requests no timing, or fails during the timing."""

    def measure(job: Job, part: PartName) -> Any:
        return bench.record(compute(replace(job, parts={part: job.requested[part]})))

    old = bench.job("dedicated")
    measure(old, "quality")
    assert measure(old, "timing").timing == timing()
    assert measure(old, "quality").timing == timing(), "a valid timing stays"

    asset = old.model.asset.model_copy(update={"sha256": "1" * 64})
    requested = {part: {**inputs, "asset": "1" * 16} for part, inputs in old.requested.items()}
    new = replace(old, model=old.model.model_copy(update={"asset": asset}), requested=requested)
    untimed = replace(new, requested={"quality": requested["quality"]})
    for job in (new, untimed):
        measure(old, "timing")
        record = measure(job, "quality")
        assert (record.asset, record.timing, set(record.inputs)) == (asset, None, {"quality"})

    measure(old, "timing")
    died = replace(new, parts={"timing": requested["timing"]})
    cells.write_lost(died, Reason(code="INTERNAL", message="it died"))
    record = read_result(Results(bench.file.results).record(died.cell))
    assert (record.timing, record.reasons["timing"].message) == (None, "it died")


@pytest.mark.parametrize("appears", [True, False])
@pytest.mark.parametrize(("option", "kept"), [("order", None), ("metrics", timing())])
def test_a_timing_is_dropped_only_if_an_option_that_affects_it_changed(
    bench: Bench, measures: dict[PartName, Any], appears: bool, option: str, kept: object
) -> None:
    """The protocol no longer requests a timing, and an option of the images is added or removed."""
    job = bench.job("dedicated")
    timed = {"order": "global"} if option == "order" and not appears else {}
    images = {name: text for name, text in job.requested["quality"].items() if name != option}
    with_option = {**images, option: "global"}
    before, after = (images, with_option) if appears else (with_option, images)
    requested = {"quality": before, "timing": {**job.requested["timing"], **timed}}
    compute(replace(job, parts=requested, requested=requested))
    later = replace(job, parts={"quality": after}, requested={"quality": after})
    assert bench.record(compute(later)).timing == kept


class Engine:
    """An engine whose images are uniformly red; it cannot draw without reading its image back."""

    name, version = "red engine", "1.2"
    color: tuple[float, float, float] | None = (1.0, 0.0, 0.0)

    def __init__(self, asset: Any, *, device: Any = None, settings: Any = None) -> None: ...

    def render(self, camera: Any, background: Any) -> Frame:
        image = np.full((camera.height, camera.width, 3), self.color or background, np.float32)
        plane = np.zeros(image.shape[:2], np.float32)
        return Frame(image, plane, plane)

    def memory(self) -> dict[str, int]:
        return {}

    def close(self) -> None: ...


@pytest.fixture
def red(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    names = {**renderers(), "red": "tests.bench.test_cell:Engine"}
    for module in ("msb.render.backend", "msb.bench.plan"):
        monkeypatch.setattr(f"{module}.renderers", lambda: names, raising=False)
    bench.file = change_tables(bench.file, engines=("red",))
    return bench


def test_a_new_version_of_an_engine_renders_again(red: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Engine, "installed", lambda: "1.2", raising=False)
    red.compute("red", "quality")
    assert "quality" not in red.plan("red").why
    monkeypatch.setattr(Engine, "installed", lambda: "1.3")
    assert red.plan("red").why["quality"] == "renderer changed"


def test_an_engine_is_a_condition(red: Bench) -> None:
    done = red.compute("red", "quality", "timing")
    record = red.record(done)
    assert done.cell.condition_name == "red"
    assert (record.cell.condition, record.cell.renderer, record.status) == ("standard", "red", "done")
    renderer = record.renderer
    assert (renderer.kind, renderer.name, renderer.version) == ("engine", "red engine", "1.2")
    assert record.quality.psnr < 10
    assert record.timing is None
    assert record.reasons["timing"].code == "UNSUPPORTED_TIER"


def test_empty_images_are_a_failure(red: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Engine, "color", None)
    record = red.record(red.compute("red", "quality"))
    assert (record.status, record.quality) == ("failed", None)
    assert record.reason.code == "METRIC_NOTHING_SHOWN"


@pytest.mark.parametrize(("scale", "value"), [(1, np.nan), (255, 1)])
def test_float_renderings_are_checked_before_they_become_bytes(
    bench: Bench, tmp_path: Path, scale: float, value: float
) -> None:
    job = bench.job("standard")
    scene = job.scene.read()
    for name, camera in zip(image_names(scene.test), scene.test, strict=True):
        path = tmp_path / "official" / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        image = np.full((camera.height, camera.width, 3), 0.5 * scale, np.float32)
        image[0, 0, 0] = value
        np.save(path, image)
    official = replace(job, renders=tmp_path / "official", parts={"quality": job.parts["quality"]})
    record = bench.record(compute(official))
    assert (record.status, record.reason.code) == ("failed", "METRIC_IMAGE")


def test_the_scan_number_is_read_from_the_scene_name() -> None:
    assert parts.parse_scan_number("scan24") == 24
    with pytest.raises(Exception, match="METRIC_ARGUMENT"):
        parts.parse_scan_number("garden")
