"""Measure parts of a benchmark cell: timing, audit, trials, repairs, Chamfer distance and training."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.origin import world_positions
from msb.base.atomic import new_folder
from msb.base.limits import Limits
from msb.bench.documents import AuditDocument, ChamferDocument, RepairDocument, TrialDocument
from msb.bench.folder import REPAIRS_FOLDER, TRIAL_FOLDER
from msb.bench.job import Job
from msb.bench.nvml import read_driver_memory
from msb.bench.photographs import read_planned_scene
from msb.bench.protocol_tables import TrialTable
from msb.bench.quality import open_renderer
from msb.bench.records import Memory, Training, read_renderer_timing
from msb.errors import InputError, MetricError, Unsupported
from msb.render.backend import Group
from msb.render.machine import machine
from msb.scenes import Camera
from msb.scenes.datasets import Scene


def measure_timing(job: Job) -> dict[str, Any]:
    """Return the timing, the memory, the fixed cost and the device of a benchmark cell.

    No file is written during the timing.
    """
    from msb.bench.floor import measure_floor
    from msb.bench.profile import profile
    from msb.render.backend import find_renderer

    if job.cell.renderer and not hasattr(find_renderer(job.cell.renderer), "draw"):
        text = f"{job.cell.renderer} cannot be timed, because it always reads its images back"
        raise Unsupported("UNSUPPORTED_TIER", text)
    scene = read_planned_scene(job.scene, job.views)
    with open_renderer(job) as renderer:
        about = machine(job.device, engine=renderer.device_info)
        kind = about["device"]["kind"]
        options: dict[str, Any] = job.timing.model_dump()
        options["device_kind"] = kind if kind in ("gpu", "cpu") else "other"
        timed = profile(renderer, scene.test, scene.background, **options)
        memory = group_memory(timed.memory, timed.memory_groups, read_driver_memory(about["device"]))
    floor = measure_floor(job, scene, options["device_kind"])
    return {"timing": timed.timing, "memory": memory, "floor": floor, "device": about}


def group_memory(
    uses: Mapping[str, int], groups: Mapping[str, str], driver: tuple[int | None, str | None] = (None, None)
) -> Memory:
    """Return the memory record of a renderer.

    `uses` maps the name of each buffer to its bytes. `groups` maps the name of each buffer to its group.
    Buffers without a group are added to the group "scratch". `driver` is the result of `read_driver_memory`.
    """
    sums = dict.fromkeys(get_args(Group), 0)
    for use, size in uses.items():
        group = groups.get(use)
        sums[group if group in sums else "scratch"] += size
    return Memory(**sums, uses=dict(uses), driver_bytes=driver[0], driver_reason=driver[1])


def measure_audit(job: Job) -> dict[str, Any]:
    """Return the audit of the stored mesh of a benchmark cell."""
    from msb.api.auditing import audit

    assert job.model is not None
    return {"audit": AuditDocument.of(audit(job.model.open()).to_dict())}


def _prepare_trial(job: Job) -> tuple[Asset, tuple[Camera, ...], TrialTable, Limits]:
    """Return the asset, test cameras, trial table and library limits of a benchmark cell."""
    assert job.model is not None
    assert job.trial is not None
    limits = Limits(job.trial.seconds, job.trial.memory)
    return job.model.open(), read_planned_scene(job.scene, job.views).test, job.trial, limits


def measure_trial(job: Job) -> dict[str, Any]:
    """Return the results of the protocol's tasks on the mesh of a benchmark cell.

    For each task, an image from a test camera is written to the folder of the benchmark cell.
    """
    from msb.trial.run import try_asset

    asset, cameras, table, limits = _prepare_trial(job)
    with new_folder(job.folder / TRIAL_FOLDER) as folder:
        trials = try_asset(
            asset,
            table.tasks,
            cameras=cameras,
            limits=limits,
            device=job.device,
            keep=folder,
            meshes=False,
        )
    return {"trial": TrialDocument.of(trials.to_dict())}


def list_compared_tasks(table: TrialTable) -> tuple[str, ...]:
    """Return the names of the tasks that run on the unrepaired mesh and on each repaired mesh."""
    from msb.trial.registry import select_tasks
    from msb.trial.repairs import TASKS

    return tuple(task.name for task in select_tasks(table.tasks or TASKS))


def measure_repairs(job: Job) -> dict[str, Any]:
    """Return the comparison of repair strategies on the mesh of a benchmark cell.

    For each repair, an image from a test camera is written to the folder of the benchmark cell.
    """
    from msb.repair.plan import Options
    from msb.trial.repairs import compare, document

    asset, cameras, table, limits = _prepare_trial(job)
    options, tasks = Options(limits=limits), list_compared_tasks(table)
    with new_folder(job.folder / REPAIRS_FOLDER) as folder:
        rows = compare(asset, cameras, options, tasks=tasks, device=job.device, keep=folder)
    data = document(str(asset.path), f"{len(cameras)} test views", rows)
    return {"repairs": RepairDocument.of(data)}


def measure_chamfer(job: Job) -> dict[str, Any]:
    """Return the Chamfer distance of a DTU mesh in millimetres, after culling with the masks of all views."""
    from msb.metrics import chamfer_surface, cull_dtu, read_dtu_scan
    from msb.metrics.image_files import read_mask, read_pixels
    from msb.scenes.datasets import read_matrices

    assert job.chamfer is not None
    scan = parse_scan_number(job.cell.scene)
    data = read_dtu_scan(Path(job.chamfer.data), scan)
    scene = read_planned_scene(job.scene, job.views)
    vertices, faces, source = _read_mesh(job)
    world, scale = read_matrices(scene.root / "cameras.npz")
    # Masks are separate image files, or alpha channels of the photographs.
    separate = scene.mask_source == "mask_folder"
    masks = (
        read_mask(file) if separate else read_pixels(file, ("RGBA",))[..., 3]
        for file in find_mask_files(scene)
    )
    culled = cull_dtu(vertices, faces, world, scale, masks)
    distances = chamfer_surface(culled.vertices, culled.faces, data, job.chamfer.seed)
    about = {"scan": scan, "metric": distances.pop("identity"), "mesh": source}
    return {"chamfer": ChamferDocument.of({**distances, **about})}


def _read_mesh(job: Job) -> tuple[NDArray[Any], NDArray[Any], str]:
    """Return the vertices (V, 3) and faces (F, 3) to measure, and the path of the mesh file."""
    from msb.meshes import read_mesh

    if job.mesh is not None:
        mesh = read_mesh(job.mesh)
        return mesh.vertices, mesh.faces, str(job.mesh)
    assert job.model is not None
    asset = job.model.open()
    return world_positions(asset), asset.buffers["indices"], job.model.asset.path


def parse_scan_number(scene: str) -> int:
    """Return the scan number in the name of a DTU scene."""
    match = re.fullmatch(r"scan(\d{1,3})", scene)
    if match is None:
        text = f'"{scene}" is not a scene of DTU, whose scenes are called scan1 to scan999'
        raise MetricError("METRIC_ARGUMENT", text)
    return int(match[1])


def find_mask_files(scene: Scene) -> list[Path]:
    """Return the mask files of all views in the order of the matrices in cameras.npz."""
    from msb.scenes.datasets.layout import images_in
    from msb.scenes.datasets.photographs import MASKS

    folder = scene.root / (MASKS if scene.mask_source == "mask_folder" else scene.image_folder)
    files = images_in(folder)
    if scene.mask_source is None or not files:
        raise InputError("FILE_NOT_FOUND", "the scene has no masks", file=scene.root)
    return files


def read_native_timing(job: Job) -> dict[str, Any]:
    """Return the user's timing of the method's official renderer."""
    assert job.renderer_timing is not None
    return {"renderer_timing": read_renderer_timing(job.renderer_timing)}


def read_training(job: Job) -> dict[str, Any]:
    """Return time and memory from a record of `msb track`.

    From a record of our trainer, return only the time.
    """
    from msb.bench.track import TrainingLog, read_training_record

    assert job.training is not None
    track = read_training_record(job.training)
    if isinstance(track, TrainingLog):
        why = "our trainer runs on a CPU and records no memory"
        return {
            "training": Training(
                seconds=track.seconds,
                peak_memory_bytes=None,
                source=str(job.training),
                memory_reason=why,
                trainer="ours",
            )
        }
    if track.exit_status:
        text = (
            f"the training failed with exit status {track.exit_status}, so its time and memory are not used"
        )
        raise InputError("TRAINING_FAILED", text, file=job.training)
    training = Training(
        seconds=track.seconds,
        peak_memory_bytes=track.peak_gpu_memory_bytes,
        source=str(job.training),
        memory_reason=track.gpu_reason,
    )
    return {"training": training}
