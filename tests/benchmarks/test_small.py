"""Every benchmark runs with very small inputs, so that changes of the measured code do not break it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("msb.bench", reason="msb.bench was removed")
from benchmarks import card, pages
from msb.bench.protocol import parse_protocol
from tests.conftest import ROOT

SMALL = {
    "audit": "--sizes 5 --main 5 --rounds 1 --tools msb scatter --parts peers threads",
    "before": "HEAD --faces 2000 --rounds 1 --row standard/mesh_splatting",
    "bake_scale": "--faces 2000 --views 3 --size 64 48 --geometry kept",
    "delivery": "data_stubs/models/pebble/two_dts",
    "dedicated": "--faces 2000 --method two_dts --size 160 120 --rounds 1",
    "export": "--triangles 2000 --rounds 1",
    "repair": "--sizes 5 --rounds 1",
    "scale": "--faces 2000 --method triangle_splatting_plus --step dedicated --step weigh --step page",
    "sizes": "--faces 2000 --command info",
    "splats": "data_stubs/models/pebble/three_dgs --size 160 120 --rounds 1",
    "standard": "--scenes large --tools msb --rounds 1",
}
"""Benchmark -> options for a run of a few seconds."""


def run(*words: str) -> str:
    """Run a Python module and return its standard output."""
    command = [sys.executable, "-m", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_a_benchmark_runs_and_writes_its_results(name: str, tmp_path: Path) -> None:
    if name == "before" and not (ROOT / ".git").exists():
        pytest.skip("this copy of the code has no git history")
    kept = tmp_path / "results" / f"{name}.json"
    printed = run(f"benchmarks.{name}", *SMALL[name].split(), "--json", str(kept))
    assert "not run" not in printed
    assert json.loads(kept.read_text())["machine"]["python"]


def test_the_card_is_measured_with_the_models_that_exist(tmp_path: Path) -> None:
    scene = card.link_demo(tmp_path)
    shutil.rmtree(tmp_path / "output" / "two_dts")
    (tmp_path / "timing" / "diffsoup" / "mipnerf360").mkdir(parents=True)
    (tmp_path / "timing" / "diffsoup" / "mipnerf360" / f"{scene.name}.json").touch()
    path = card.write_protocol(tmp_path, scene, "mipnerf360", "cpu", {"image_folder": "images_8"})
    protocol = parse_protocol(path.read_bytes(), path).protocol
    methods = {method.name: method for method in protocol.methods}
    assert set(methods) == {"triangle_splatting", "mesh_splatting", "diffsoup"}
    assert all(method.training and not method.non_engine for method in methods.values())
    timed = [name for name, method in methods.items() if method.non_engine_timing]
    assert (timed, methods["diffsoup"].image_folder) == (["diffsoup"], None)
    assert (protocol.device, protocol.datasets[0].scenes) == ("cpu", (scene.name,))


@pytest.mark.slow
def test_a_card_has_its_tables(tmp_path: Path) -> None:
    """A scene with one model, which takes seconds."""
    kept = tmp_path / "card.json"
    options = ["--device", "cpu", "--minutes", "2", "--root", str(tmp_path), "--json", str(kept)]
    scene = card.link_demo(tmp_path)
    for name in ("two_dts", "mesh_splatting", "diffsoup"):  # too short for a training, so there is no model
        shutil.rmtree(tmp_path / "output" / name)
    run("benchmarks.card", "--scene", str(scene), *options)
    record = json.loads(kept.read_text())
    assert {name.partition("-")[0] for name in record} >= {"latency", "memory", "frame_time", "slowdown"}
    assert any(float(row["Train time (min) ↓"]) > 1 for row in record["native_summary"])


@pytest.mark.slow
def test_the_endurance_benchmark_runs() -> None:
    run("benchmarks.endurance", "renders", "--share", "0.01")


def test_pages_are_generated_from_the_results() -> None:
    """If this fails, run python -m benchmarks.pages."""
    texts = pages.pages()
    assert texts == {path.name: path.read_text(encoding="utf-8") for path in pages.PAGES.glob("*.md")}
    assert pages.readme(texts) == pages.README.read_text(encoding="utf-8")
    assert {path.suffix for path in pages.RESULTS.iterdir()} == {".json"}
