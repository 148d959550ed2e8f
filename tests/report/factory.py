"""Synthetic results of a complete benchmark: all datasets, scenes, methods and conditions, without rendering.

The means over scenes equal the means in the paper, if it prints them. Therefore tables of these records can
be compared with the paper. Scenes differ by offsets that sum to zero.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageFilter

from msb.base.files import file_sha256
from msb.bench.aggregate import SCENES
from msb.bench.documents import STORED, AuditDocument, BakeDocument, ChamferDocument
from msb.bench.records import (
    Cell,
    File,
    ImageQuality,
    Memory,
    Quality,
    Reason,
    RendererInfo,
    Result,
    Setup,
    Timing,
    Training,
)
from msb.registry import METHODS
from msb.report.build import build_report
from msb.report.collect import collect
from msb.report.numbers import MEAN, Key, Numbers
from msb.report.paper import paper_numbers
from msb.report.results import read_results
from msb.report.verdict import Statement
from msb.topology.audit import Metrics
from msb.topology.findings import Counts

METHODS_OF_PAPER = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")
CONDITIONS = ("non_engine", "dedicated", "standard", "exported_mesh")
VIEWS = ("a/0001.png", "a/0002.png", "a/0003.png")
SIZE = (96, 64)
SHIFTS = (-0.5, 0.0, 0.5)
"""Offset of each view's PSNR from the mean, in dB."""
SETUP = Setup(
    camera_convention="gs_fov", image_folder="images_4", gt_resized=False, background=(0.0, 0.0, 0.0)
)
METRICS: tuple[dict[str, Any], ...] = ({"name": "psnr", "data_range": 1.0}, {"name": "ssim", "window": 11})


def write_results(
    root: Path,
    *,
    datasets: Iterable[str] = tuple(SCENES),
    methods: Iterable[str] = METHODS_OF_PAPER,
    images: bool = False,
) -> Path:
    """Write records of all scenes of `datasets` below `root` and return it."""
    for dataset in datasets:
        for scene in SCENES[dataset]:
            for method in methods:
                for condition in CONDITIONS:
                    write(root, make_result(dataset, scene, method, condition), images=images)
    return root


def write(root: Path, result: Result, *, images: bool = False, **parts: Any) -> Path:
    """Write a record to the place where `msb run` writes it, and return its file.

    `parts` replace keys of its JSON. With `images` its images are written as well.
    """
    folder = root.joinpath("cells", *result.cell.names)
    folder.mkdir(parents=True, exist_ok=True)
    if images and result.quality is not None:
        write_images(folder, result.quality)
    data = {**json.loads(result.to_json()), **parts}
    path = folder / "result.json"
    path.write_text(json.dumps(data))
    if images:
        update_hashes(path)
    return path


def update_hashes(path: Path) -> None:
    """Update the hashes in a record to its current images."""
    data = json.loads(path.read_text())
    for image in data["quality"]["images"] if data["quality"] else ():
        image["sha256"] = file_sha256(path.parent / image["file"])
    path.write_text(json.dumps(data))


def measure(
    root: Path,
    condition: str,
    psnr: float | None = None,
    ssim: float = 0.5,
    /,
    *,
    shifts: tuple[float, ...] = SHIFTS,
    images: bool = False,
    **changes: Any,
) -> Result:
    """Write a record and return it. By default it is a record of 2DTS on the scene "desk".

    `changes` are the dataset, scene and method, and attributes of the record. A mapping replaces only parts
    of an attribute.
    """
    default_place = {"dataset": "capture", "scene": "desk", "method": "two_dts"}
    dataset, scene, method = (changes.pop(name, default) for name, default in default_place.items())
    record = make_result(dataset, scene, method, condition)
    if psnr is not None:
        changes["quality"] = quality(psnr, ssim, shifts=shifts, cell=record.cell)
    for name, value in changes.items():
        current = getattr(record, name)
        is_part = isinstance(value, dict) and not isinstance(current, dict)
        changes[name] = current.model_copy(update=value) if is_part else value
    record = record.model_copy(update=changes)
    write(root, record, images=images)
    return record


def numbers_of(root: Path, **options: Any) -> Numbers:
    """Return the numbers of a results folder."""
    return collect(read_results(root, **options))


def verdict_of(root: Path) -> dict[str, Statement]:
    """Return the statements on the only asset in a results folder, by use."""
    (verdict,) = build_report(read_results(root), pictures=False).verdicts
    return {statement.use: statement for statement in verdict.statements}


def make_result(dataset: str, scene: str, method: str, condition: str, **changes: Any) -> Result:
    """Return the record of a cell; `changes` replaces its attributes."""
    cell = Cell(dataset=dataset, scene=scene, method=method, condition=condition)
    definition = METHODS.get(method)
    why = definition and definition.unsupported.get(condition)
    if why:
        reason = Reason(code="UNSUPPORTED", message=why)
        return Result(cell=cell, status="unsupported", reason=reason, seconds=0.0)
    asset = File(
        path="x.triasset", bytes=round(_value(cell, "asset_size")), sha256=_sha(f"{dataset}/{scene}/{method}")
    )
    parts: dict[str, Any] = {"cell": cell, "status": "done", "seconds": 1.5, "asset": asset}
    if condition == "exported_mesh":
        parts["audit"] = AuditDocument.of(AUDIT)
    else:
        parts |= _parts_of_drawn(cell)
    return Result(**{**parts, **changes})


def result(condition: str = "dedicated", **changes: Any) -> Result:
    """Return the record of 2DTS on the scene "garden" of Mip-NeRF 360, like `make_result`."""
    return make_result("mipnerf360", "garden", "two_dts", condition, **changes)


def bake(
    label: str, geometry: str = "kept", *, source_cell: Cell | None = None, **facts: Any
) -> dict[str, Any]:
    """Return the attributes that turn a record of the standard tier into the record of a bake.

    `source_cell` is the cell of the model that is baked; `facts` replace keys of the bake's JSON.
    """
    cell = source_cell or Cell(dataset="mipnerf360", scene="garden", method="two_dts", condition="standard")
    source = make_result(cell.dataset, cell.scene, cell.method, "dedicated").asset
    verdict = {"level": "bad", "sentence": "a soup"}
    photographs = {"native": 30.0, "before": 18.0, "after": 21.0, "after_16": 22.5}
    document = {
        **{"schema": "msb.bake/1", "path": None, "output": None, "geometry": geometry, "color": "vertex"},
        **{"vertices": 300, "faces": 100, "texture": None, "bytes": 9000, "seconds": 7.0},
        **{
            "views": {
                "training": 8,
                "validation": 1,
                "test": 3,
                "interpolated": 0,
                "from": "9 training views",
            },
            "unseen_area": 0.1,
        },
        **{"psnr": {"native": None, "photographs": photographs}},
        **{"verdict_before": verdict, "verdict_after": verdict, "lods": [], "collision": None},
        **{"supervision": "native", "model_faces": 120, "background": [0.0, 0.0, 0.0], "seed": 0},
        **{"device": "Made-up GPU", "tried": {}, "notes": [], "sentence": "baked 21.0"},
        **facts,
    }
    return {
        "cell": cell.model_copy(update={"condition": "standard", "bake": label}),
        "source": source,
        "asset": File(path=f"{label}.triasset", bytes=9000, sha256=_sha(label)),
        "bake": BakeDocument.of(document),
        "audit": AuditDocument.of(AUDIT),
    }


def timing(fps: float = 100.0, **changes: Any) -> Timing:
    """Return the timing of 100 frames of equal duration."""
    spans = ("p50_ms", "p95_ms", "mean_ms", "busy_p50_ms", "busy_p95_ms")
    parts: dict[str, Any] = dict.fromkeys(spans, 1000 / fps)
    parts |= {"frames": 100, "seconds": 100 / fps, "fps": fps, "round_fps": (fps, fps)}
    parts |= {"queued_p50_ms": None, "queued_p95_ms": None, "stages_ms": {}, "device_kind": "cpu"}
    return Timing(**{**parts, **changes})


def at_rate(fps: float) -> dict[str, float]:
    """Return the attributes of a timing that give `fps` frames per second."""
    return {"fps": fps, "seconds": 100 / fps}


def quality(
    psnr: float = 20.0,
    ssim: float = 0.5,
    lpips: float | None = None,
    *,
    shifts: tuple[float, ...] = SHIFTS,
    cell: Cell | None = None,
) -> Quality:
    """Return image quality with the given means over three views, whose PSNR differs by `shifts` (in dB).

    The files belong to `cell`, by default 2DTS on the scene "garden" of Mip-NeRF 360.
    """
    cell = cell or Cell(dataset="mipnerf360", scene="garden", method="two_dts", condition="dedicated")
    depth = "../../../../.."
    images = tuple(
        ImageQuality(
            name=name,
            width=SIZE[0],
            height=SIZE[1],
            psnr=psnr + shift,
            ssim=ssim,
            lpips=lpips,
            file=f"images/{Path(name).with_suffix('.png')}",
            sha256=_sha(f"{cell}{name}"),
            gt=f"{depth}/ground_truth/{cell.dataset}/{cell.scene}/one/{Path(name).with_suffix('.png')}",
        )
        for name, shift in zip(VIEWS, shifts, strict=True)
    )
    return Quality(
        psnr=psnr,
        ssim=ssim,
        lpips=lpips,
        lpips_reason=None if lpips is not None else "no VGG weights (--vgg-weights FILE)",
        psnr_inf_count=0,
        images=images,
        metrics=METRICS,
    )


def write_images(folder: Path, measured: Quality) -> None:
    """Write the ground truth, and blurred renderings. A lower PSNR gives a stronger blur."""
    for image in measured.images:
        photograph = ground_truth(image.name)
        path = folder / str(image.gt)
        path.parent.mkdir(parents=True, exist_ok=True)
        photograph.save(path)
        blurred = photograph.filter(ImageFilter.GaussianBlur(max(0.0, (32 - image.psnr) / 4)))
        path = folder / str(image.file)
        path.parent.mkdir(parents=True, exist_ok=True)
        blurred.save(path)


def ground_truth(name: str) -> Image.Image:
    """Return an image with edges and colours."""
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    seed = int(_sha(name)[:4], 16)
    disc = (x - width / 2) ** 2 + (y - height / 2) ** 2 < (height / 3) ** 2
    checks = ((x // 8 + y // 8) % 2).astype(bool)
    pixels = np.stack([(x * 2 + seed) % 256, (y * 3) % 256, np.where(checks, 60, 200)], axis=-1)
    pixels[disc] = (230, 120, 40)
    return Image.fromarray(pixels.astype(np.uint8))


def _parts_of_drawn(cell: Cell) -> dict[str, Any]:
    """Return the attributes of a record with images: setup, quality, renderer, timing, memory, training."""
    values = {metric: _value(cell, metric) for metric in ("psnr", "ssim", "lpips", "fps", "p50_ms", "p95_ms")}
    lpips = values["lpips"] if cell.dataset != "dtu" else None
    parts: dict[str, Any] = {
        "setup": SETUP,
        "quality": quality(values["psnr"], values["ssim"], lpips, cell=cell),
        "device": {"device": {"name": "Made-up GPU", "platform": "none"}},
    }
    kind: Any = "upstream" if cell.condition == "non_engine" else "msb"
    parts["renderer"] = RendererInfo(name=cell.condition, version="1", kind=kind)
    p50, p95 = ({f"{kind}{name}": values[name] for kind in ("", "busy_")} for name in ("p50_ms", "p95_ms"))
    of_gpu = {**p50, **p95, "round_fps": (), "device_kind": "gpu"}
    parts["timing"] = timing(values["fps"], **of_gpu)
    memory = int(_value(cell, "memory"))
    parts["memory"] = Memory(geometry=memory, appearance=0, scratch=0, targets=0, uses={"all": memory})
    if cell.condition == "non_engine":
        minutes = _value(cell, "train_seconds")
        peak = int(_value(cell, "train_memory"))
        parts["training"] = Training(seconds=minutes, peak_memory_bytes=peak, source="track.json")
        if cell.dataset == "dtu":
            parts["chamfer"] = ChamferDocument.of(chamfer(_value(cell, "chamfer")))
    return parts


_FALLBACK: dict[str, dict[str, float]] = {
    "non_engine": {"psnr": 1, "ssim": 1, "lpips": 0.3, "fps": 90, "p50_ms": 9, "p95_ms": 9.4, "memory": 3e8,
                   "train_seconds": 1500, "train_memory": 8e9, "chamfer": 1},
    "dedicated": {"psnr": 0.85, "ssim": 0.8, "lpips": 0.4, "fps": 500, "p50_ms": 2, "p95_ms": 2.2,
                  "memory": 3e8},
    "standard": {"psnr": 0.6, "ssim": 0.5, "lpips": 0.6, "fps": 3000, "p50_ms": 0.3, "p95_ms": 0.3,
                 "memory": 1e8},
}  # fmt: skip
"""Values by condition and metric that replace values missing in the paper.

For PSNR and SSIM they are factors of the Non-Engine values.
"""


def _value(cell: Cell, metric: str) -> float:
    """Return the value of a metric on the scene of `cell`: the mean of the dataset plus an offset."""
    mean = _paper().value(Key(cell.dataset, MEAN, cell.method, cell.condition, metric))
    if metric == "asset_size":  # equal under all conditions
        mean = _paper().value(Key(cell.dataset, MEAN, cell.method, "dedicated", metric)) or 1e8
    if mean is None:
        native = _paper().value(Key(cell.dataset, MEAN, cell.method, "non_engine", metric)) or 1.0
        mean = _FALLBACK[cell.condition][metric] * (native if metric in ("psnr", "ssim") else 1)
    scenes = SCENES.get(cell.dataset, (cell.scene,))
    place = scenes.index(cell.scene) if cell.scene in scenes else 0
    spread = 0.01 if metric == "ssim" else 0.1  # SSIM must not exceed 1
    return mean * (1 + spread * (place - (len(scenes) - 1) / 2) / len(scenes))


@cache
def _paper() -> Any:
    return paper_numbers()


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


AUDIT: dict[str, Any] = {
    "schema": "msb.audit/1",
    "path": "x.triasset",
    "method": None,
    "topology": "indexed_mesh",
    "is_soup": False,
    "verdict": {
        "level": "bad",
        "sentence": "renders; not usable for subdivision, booleans or printing because 18 % of its "
        "edges and 65 % of its vertices are non-manifold",
    },
    "counts": {field.name: 0 for field in fields(Counts)}
    | {"vertices": 520, "faces": 1000, "edges": 1690, "nonmanifold_vertices": 338, "boundary_edges": 760,
       "nonmanifold_edges": 304, "components": 710_000, "largest_component_faces": 700},
    "metrics": {field.name: 1.0 for field in fields(Metrics)}
    | {"vf_ratio": 0.52, "mean_valence": 6.49, "boundary_edge_ratio": 0.45, "nonmanifold_edge_ratio": 0.18,
       "nonmanifold_vertex_ratio": 0.65, "lcc_face_ratio": 0.70, "lcc_area_ratio": 0.69,
       "components": 710_000, "euler_characteristic": -170},
    "variants": {},
    "winding_consistent": True,
    "valence_histogram": {},
    "samples": {},
    "welded": None,
    "cross_check": None,
    "timings_ms": {},
    "computed_by": "NumPy",
}  # fmt: skip
WALK: dict[str, Any] = {
    "frames": 24,
    "width": 160,
    "height": 120,
    "flicker": 1.25,
    "flicker_worst": 2.5,
    "worst_frame": 1,
    "holes": 0.01,
    "film": None,
    "seconds": 1.0,
}
TASK: dict[str, Any] = {
    "task": "uv",
    "title": "UV unwrapping",
    "outcome": "fails",
    "why": "it falls into <9> charts",
    "seconds": 1.25,
    "numbers": {},
    "libraries": {},
    "says": "9 charts",
    "files": ["uv.png"],
    "picture": "uv.png",
}
SAME = {"psnr": None, "same": True, "why": None}


def chamfer(overall: float) -> dict[str, Any]:
    """Return the JSON of a Chamfer distance, in mm."""
    return {
        "mean_d2s": 1,
        "mean_s2d": 1,
        "overall": overall,
        "reason": None,
        "metric": {"name": "chamfer_dtu"},
        "mesh": "x.triasset",
    }


def trial(*tasks: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of trial tasks."""
    return {
        "schema": "msb.trial/1",
        "path": None,
        "trials": list(tasks),
        "mesh": {},
        "limits": {},
        "cameras": {},
    }


def strategy_json(strategy: str, /, **changes: Any) -> dict[str, Any]:
    """Return the JSON of a repair strategy: by default nothing changes, and one of three tasks works."""
    unchanged = {
        "strategy": strategy,
        "plan": [] if strategy == STORED else strategy.split(","),
        "peer": None,
        "why": None,
        "faces_kept": 100,
        "faces_added": 0,
        "edges_cut": 0,
        "vertices": 60,
        "components": 4,
        "boundary_edge_ratio": 0.5,
        "nonmanifold_edges": 1,
        "nonmanifold_vertices": 2,
        "inconsistent_winding_edges": 0,
        "verdict_before": "bad",
        "verdict_after": "bad",
        "looks": {"standard": SAME, "dedicated": SAME},
        "trials": {"uv": "fails", "solid": "fails", "boolean": "care"},
        "trials_passed_before": 1,
        "trials_passed_after": 1,
        "bytes": 1 << 20,
        "seconds": 0.25,
        "picture": None,
    }
    return {**unchanged, **changes}


def repairs(*ways: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of a comparison of repair strategies."""
    return {
        "schema": "msb.repair_compare/1",
        "path": None,
        "views": "3 test views",
        "strategies": list(ways),
    }
