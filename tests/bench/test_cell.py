"""One cell, computed in this process: LPIPS, engines, bugs, and what an old record keeps."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.bench import cell as cells
from msb.bench import parts
from msb.bench.cell import compute
from msb.bench.folder import Results, exclusive
from msb.bench.inputs import Known
from msb.bench.job import Done, Job, Part
from msb.bench.models import prepare_model
from msb.bench.photographs import PhotographTask, write_photographs
from msb.bench.plan import Planned, Planner, pairs_of
from msb.bench.protocol import ProtocolFile
from msb.bench.records import Reason, read_result
from msb.metrics import registry
from msb.render.backend import renderers
from msb.render.frame import Frame
from msb.render.images import image_names
from tests.bench.protocols import changed, protocol
from tests.report.factory import timing


class Bench:
    """The stages of a run, one cell at a time, in this process."""

    def __init__(self, file: ProtocolFile, run: str) -> None:
        self.file, self.run = file, run

    def plan(self, only: str, *, redo: bool = False) -> list[Planned]:
        pairs = pairs_of(self.file)
        models: dict[Any, Any] = {}
        for pair in pairs:
            task = pair.task(self.file.results, self.run)
            models[pair] = prepare_model(task)
        return Planner(self.file, self.run, Known(), [only], redo=redo).plan(pairs, models)

    def job(self, only: str) -> Job:
        (planned,) = self.plan(only, redo=True)
        write_photographs(PhotographTask(self.file.results, self.run, planned.job.scene, planned.job.views))
        return planned.job

    def compute(self, only: str, *names: str) -> Done:
        job = self.job(only)
        return compute(replace(job, parts={part: job.parts[part] for part in names}))

    def record(self, done: Done) -> Any:
        return read_result(Results(self.file.results).record(done.cell))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    file = protocol(tmp_path, ("mesh_splatting",))
    with exclusive(file.results) as run:
        yield Bench(file, run)


class FakeNetwork:
    """Stands for LPIPS: the mean absolute difference, so that no weights are needed."""

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
def test_lpips_is_measured_where_there_are_weights(bench: Bench, tmp_path: Path, fake_network: None) -> None:
    bench.file = changed(bench.file, metrics={"vgg_weights": "vgg.pth"})
    assert bench.job("standard").vgg_weights == tmp_path / "vgg.pth"
    found = bench.record(bench.compute("standard", "quality")).quality
    assert found.lpips == pytest.approx(np.mean([image.lpips for image in found.images]))
    assert found.lpips > 0.005
    assert found.lpips_reason is None
    assert [one["name"] for one in found.metrics] == ["psnr", "ssim", "lpips_vgg"]
    assert found.metrics[2]["weights"]["vgg"]["sha256"] == "0" * 64
    bench.file = changed(bench.file, metrics={"vgg_weights": None})
    (planned,) = bench.plan("standard")
    assert planned.why["quality"] == "metrics changed"


@pytest.mark.slow
def test_a_bug_costs_one_part_and_says_where(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_job: Job) -> dict[str, Any]:
        raise KeyError("what")

    monkeypatch.setitem(cells.MEASURES, "timing", broken)
    done = bench.compute("dedicated", "quality", "timing")
    found = bench.record(done)
    assert (done.status, found.status) == ("done", "done")
    assert found.quality is not None
    assert found.reasons["timing"].code == "INTERNAL"
    monkeypatch.setitem(cells.MEASURES, "quality", broken)
    done = bench.compute("dedicated", "quality")
    found = bench.record(done)
    assert (done.status, found.reason.code, found.quality) == ("failed", "INTERNAL", None)


@pytest.mark.slow
def test_a_timing_keeps_the_images_and_the_other_way_round(bench: Bench) -> None:
    first = bench.record(bench.compute("dedicated", "quality"))
    second = bench.record(bench.compute("dedicated", "timing"))
    assert second.quality == first.quality
    assert second.setup == first.setup
    assert second.renderer == first.renderer
    assert second.timing is not None
    assert second.seconds > first.seconds
    third = bench.record(bench.compute("dedicated", "quality"))
    assert (third.timing, third.memory, third.device) == (second.timing, second.memory, second.device)
    assert second.floor == third.floor
    assert 0 < second.floor.memory_bytes < second.memory.total
    assert (second.floor.width, second.floor.height) == next(
        (image.width, image.height) for image in first.quality.images
    )
    assert set(third.inputs) == {"quality", "timing"}


def test_a_new_asset_has_no_number_of_the_old_one(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of a new model that ends before the timing, or whose timing dies, or that times no more."""

    def measured(job: Job, part: Part) -> Any:
        return bench.record(compute(replace(job, parts={part: job.wanted[part]})))

    monkeypatch.setitem(cells.MEASURES, "quality", lambda _: {"device": {}})
    monkeypatch.setitem(cells.MEASURES, "timing", lambda _: {"timing": timing()})
    old = bench.job("dedicated")
    measured(old, "quality")
    assert measured(old, "timing").timing == timing()
    assert measured(old, "quality").timing == timing(), "what still holds stays"

    asset = old.model.asset.model_copy(update={"sha256": "1" * 64})
    wanted = {part: {**inputs, "asset": "1" * 16} for part, inputs in old.wanted.items()}
    new = replace(old, model=old.model.model_copy(update={"asset": asset}), wanted=wanted)
    untimed = replace(new, wanted={"quality": wanted["quality"]})
    for job in (new, untimed):
        measured(old, "timing")
        found = measured(job, "quality")
        assert (found.asset, found.timing, set(found.inputs)) == (asset, None, {"quality"})

    measured(old, "timing")
    died = replace(new, parts={"timing": wanted["timing"]})
    cells.write_lost(died, Reason(code="INTERNAL", message="it died"))
    found = read_result(Results(bench.file.results).record(died.cell))
    assert (found.timing, found.reasons["timing"].message) == (None, "it died")


class Engine:
    """An engine that sees nothing but red, and cannot draw without reading back."""

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
    there = {**renderers(), "red": "tests.bench.test_cell:Engine"}
    for module in ("msb.render.backend", "msb.bench.plan"):
        monkeypatch.setattr(f"{module}.renderers", lambda: there, raising=False)
    bench.file = changed(bench.file, engines=("red",))
    return bench


def test_an_update_of_an_engine_draws_its_cells_again(red: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Engine, "installed", lambda: "1.2", raising=False)
    red.compute("red", "quality")
    (planned,) = red.plan("red")
    assert "quality" not in planned.why
    monkeypatch.setattr(Engine, "installed", lambda: "1.3")
    (planned,) = red.plan("red")
    assert planned.why["quality"] == "renderer changed"


def test_an_engine_has_a_column_of_its_own(red: Bench) -> None:
    bench = red
    done = bench.compute("red", "quality", "timing")
    found = bench.record(done)
    assert done.cell.condition_name == "red"
    assert (found.cell.condition, found.cell.renderer, found.status) == ("standard", "red", "done")
    assert (found.renderer.kind, found.renderer.name, found.renderer.version) == (
        "engine",
        "red engine",
        "1.2",
    )
    assert found.quality.psnr < 10
    assert found.timing is None
    assert found.reasons["timing"].code == "UNSUPPORTED_TIER"


def test_a_condition_that_shows_nothing_has_no_number_but_a_reason(
    red: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Engine, "color", None)
    found = red.record(red.compute("red", "quality"))
    assert (found.status, found.quality) == ("failed", None)
    assert found.reason.code == "METRIC_NOTHING_SHOWN"


@pytest.mark.parametrize(("scale", "value"), [(1, np.nan), (255, 1)])
def test_official_floats_are_checked_before_they_become_bytes(
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
    own = replace(job, renders=tmp_path / "official")
    found = bench.record(compute(replace(own, parts={"quality": job.parts["quality"]})))
    assert (found.status, found.reason.code) == ("failed", "METRIC_IMAGE")


def test_chamfer_needs_a_scan(bench: Bench) -> None:
    assert parts.scan_number("scan24") == 24
    with pytest.raises(Exception, match="METRIC_ARGUMENT"):
        parts.scan_number("garden")
