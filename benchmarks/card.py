"""Measure the paper's quantities on a graphics card by `msb run`: `python -m benchmarks.card --scene DIR`.

`--root` is the folder of paper.toml, in which the recipes write models, records of their trainings and
timings of the official renderers (docs/models.md). If a model is missing, our own trainer makes one on this
machine (extra train, on the CPU); all such trainings share half of the time. Then `msb run` evaluates all
models on the scene, and the report's tables of times, memory, ratios and trainings are kept as JSON. Without
`--scene` the demo's scene and models are measured, in two minutes on a CPU.

The whole takes at most `--minutes`; what is not finished by then is missing, and the same command goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.measure import keep, machine
from msb.base.extras import is_installed
from msb.bench.folder import Results
from msb.bench.protocol import parse_protocol, read_example
from msb.bench.protocol_tables import MethodTable
from msb.bench.records import read_result
from msb.render.backend import why_unavailable
from msb.scenes.datasets import dataset_of

STUBS = Path(__file__).parent.parent / "data_stubs"
TABLES = (
    "renderer_comparison",
    "latency",
    "frame_time",
    "runtime_resources",
    "memory",
    "slowdown",
    "native_summary",
)
"""First words in the labels of the report's tables that are kept."""
RESERVE = 20.0
"""Seconds at the end for the report."""
PATHS = "model", "training", "non_engine", "non_engine_timing"
KEYS = "image_folder", "resolution", "held_out", *PATHS
"""Keys of a method in the paper's protocol that are taken over."""


def list_methods(dataset: str) -> Iterator[MethodTable]:
    """Yield the methods of the paper's protocol that have models of a dataset."""
    for method in parse_protocol(read_example("paper"), "paper.toml").protocol.methods:
        if method.model is not None and (not method.datasets or dataset in method.datasets):
            yield method


def link_demo(root: Path) -> Path:
    """Put the demo's models and their records where the paper's protocol expects them; return the scene."""
    scene = STUBS / "scenes" / "mipnerf360" / "pebble"
    for folder in sorted((STUBS / "models" / "walled").iterdir()):
        place, record = (root / kind / folder.name / "mipnerf360" for kind in ("output", "training"))
        shutil.copytree(folder, place / scene.name, dirs_exist_ok=True)
        record.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "training.json", record / f"{scene.name}.json")
    return scene


def write_protocol(root: Path, scene: Path, dataset: str, device: str, options: Mapping[str, Any]) -> Path:
    """Write the paper's protocol for one scene and the inputs that exist; return its path.

    `options` are further keys of the dataset.
    """
    names = {"dataset": dataset, "scene": scene.name}
    wgpu = why_unavailable("wgpu") is None
    lines = [f"device = {json.dumps(device)}", 'results = "card"', f"engines = {json.dumps(['wgpu'] * wgpu)}"]
    lines += ["[[variants]]", 'label = "engine"', 'order = "global"', 'sampling = "engine"']
    lines += ["[[variants]]", 'label = "hardware"', 'renderer = "wgpu"'] if wgpu else []
    lines += ["[[datasets]]", f"name = {json.dumps(dataset)}", f"path = {json.dumps(str(scene.parent))}"]
    lines += [f"scenes = {json.dumps([scene.name])}"]
    lines += [f"{name} = {json.dumps(value)}" for name, value in options.items() if value is not None]
    for method in list_methods(dataset):
        keys = {name: value for name in KEYS if (value := getattr(method, name))}
        # Options of this run replace those of the protocol. Files that no recipe wrote are left out.
        for name in list(keys):
            path = method.name if name not in PATHS else keys[name].format(method=method.name, **names)
            if options.get(name) is not None or (name in PATHS and not (root / path).exists()):
                del keys[name]
        if "model" in keys:
            lines += ["[[methods]]", f"name = {json.dumps(method.name)}"]
            lines += [f"{name} = {json.dumps(value)}" for name, value in keys.items()]
    path = root / "card.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def train_missing(root: Path, scene: Path, dataset: str, seconds: float, options: Mapping[str, Any]) -> None:
    """Train the missing models of the four methods by our trainer under `msb track`, within `seconds`."""
    missing = [
        method.name
        for method in list_methods(dataset)
        if method.name != "two_dgs" and not (root / "output" / method.name / dataset / scene.name).exists()
    ]
    if missing and not is_installed("torch"):
        print(f"not trained, because torch is not installed: {', '.join(missing)}", flush=True)
        return
    for name in missing:
        place, record = (root / kind / name / dataset for kind in ("output", "training"))
        record.mkdir(parents=True, exist_ok=True)
        track = ["-m", "msb", "track", "--force", "-o", str(record / f"{scene.name}.json"), "--"]
        train = ["-m", "data_stubs.training", "--scene", str(scene), "--method", name]
        train += ["--minutes", str(seconds / len(missing) / 60), "--output", str(place / scene.name)]
        for option, value in options.items():
            train += [] if value is None else [f"--{option.replace('_', '-')}", str(value)]
        run([sys.executable, *track, sys.executable, *train], seconds)


def run(command: list[str], seconds: float) -> None:
    """Run a command, and interrupt it after `seconds`; its failure does not stop the others."""
    print("+", " ".join(command[1:]), flush=True)
    with subprocess.Popen(command, start_new_session=True) as child:
        try:
            child.wait(timeout=max(1.0, seconds))
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGINT)  # msb run ends its workers and keeps the finished cells
            print("interrupted: the time is over", flush=True)


def read_tables(folder: Path) -> dict[str, list[dict[str, str]]]:
    """Return label -> rows (heading -> printed text) of the kept tables of a report."""
    kept = {}
    for path in sorted(folder.glob("*.json")):
        if path.stem.partition("-")[0] in TABLES:
            table = json.loads(path.read_text())
            heads = [", ".join((*column["groups"], column["title"])) for column in table["columns"]]
            kept[path.stem] = [
                dict(zip(table["heads"], row["labels"], strict=True))
                | dict(zip(heads, [cell["text"] for cell in row["cells"]], strict=True))
                for row in table["rows"]
            ]
    return kept


def read_notes(results: Path) -> list[str]:
    """Return a sentence on the devices and image sizes of the records, and one for each missing part."""
    devices, sizes, reasons = {}, {}, {}
    for path in Results(results).records():
        result = read_result(path)
        for image in () if result.quality is None else result.quality.images:
            sizes[f"{image.width} x {image.height}"] = None
        if result.timing is not None and (name := result.drawn_on.get("name")):
            devices[str(name)] = None
        for part, reason in result.reasons.items():
            reasons[f"{result.cell.model_name}, {result.cell.condition_name}, {part}: {reason.code}"] = None
    return [f"Devices: {', '.join(devices)}. Image sizes: {', '.join(sizes)}", *reasons]


def main() -> int:
    """Train, run, report and keep; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--scene", type=Path, help="folder of a scene; default: the demo's")
    add("--root", type=Path, default=Path("out/card"), help="folder of paper.toml and its models (out/card)")
    add("--device", default="gpu", help="gpu, cpu, or a device name from msb devices")
    add("--image-folder", help="folder of the photographs, if not the dataset's default")
    add("--resolution", type=int, help="1, 2, 4 or 8 divide the photographs' size")
    add("--minutes", type=float, default=12.0, help="time for everything (12)")
    add("--json", type=Path, help="file for the tables, such as benchmarks/results/card-h200.json")
    given = parser.parse_args()
    end = time.monotonic() + 60 * given.minutes - RESERVE
    root = given.root.resolve()
    root.mkdir(parents=True, exist_ok=True)
    scene = link_demo(root) if given.scene is None else given.scene.resolve()
    dataset, options = dataset_of(scene), {"image_folder": given.image_folder, "resolution": given.resolution}
    train_missing(root, scene, dataset, (end - time.monotonic()) / 2, options)
    protocol = write_protocol(root, scene, dataset, given.device, options)
    run([sys.executable, "-m", "msb", "run", str(protocol)], end - time.monotonic())
    report = [str(root / "card"), "-o", str(root / "report"), "--format", "json", "--no-paper", "--force"]
    subprocess.run([sys.executable, "-m", "msb", "report", *report], check=True)
    what = f"`msb run --device {given.device}` of {dataset}, {scene.name}, and tables of its report"
    record: dict[str, Any] = {
        "what": what,
        "measured": time.strftime("%Y-%m-%d"),
        "machine": machine("numpy", "pyopencl"),
    }
    record |= {"notes": read_notes(root / "card"), **read_tables(root / "report" / "tables")}
    keep(record, given.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
