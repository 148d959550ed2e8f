"""The inputs of each part of a benchmark cell, as hashes and versions.

A part with a changed input is computed again.

Versions of libraries are recorded but are not inputs, so an update of NumPy does not repeat any rendering.
The device is an input of timings only, because images do not depend on the device. The record of the images
still names their rendering device.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from msb.base.extras import is_installed
from msb.base.files import file_sha256
from msb.base.version import __version__
from msb.bench.digest import digest
from msb.bench.job import Job, PartInputs, PartName
from msb.bench.models import ModelAsset
from msb.bench.parts import find_mask_files, list_compared_tasks, parse_scan_number
from msb.bench.photographs import ViewState, describe_camera, describe_views
from msb.bench.protocol_tables import ChamferTable, TrialTable, WalkTable
from msb.bench.quality import hash_metrics
from msb.bench.renders import find_renders
from msb.bench.walk import plan_walk
from msb.errors import Finding, MsbError
from msb.metrics.identity import defined
from msb.metrics.steadiness import BLUR, REACH, SAME
from msb.scenes.datasets import Scene, SceneAt, compare_training, note_scaled_cameras, warn_unknown_split

# The note on a model whose training split is not recorded but confirmed by the protocol.
VOUCHED = (
    "its training does not record the held-out views; the key held_out of the protocol confirms that the "
    "test views were held out"
)
# Number of hexadecimal digits of a hash in a record. 16 digits are 64 bits, which is enough to detect a
# changed input.
_SHORT_DIGITS = 16
# Paths in DTU's official evaluation data: point cloud, observation mask and ground plane of a scan.
_CLOUD, _GRID, _PLANE = "Points/stl/stl{:03d}_total.ply", "ObsMask/ObsMask{}_10.mat", "ObsMask/Plane{}.mat"


class InputReader:
    """Reads scenes, hashes and versions once for a whole run plan, and collects warnings about them."""

    def __init__(self, device: Mapping[str, Any] | None = None) -> None:
        # The record of the OpenCL device, or None without a device.
        self.device = device
        # Warnings about scenes and invalid records. A dictionary keeps the warnings in order and without
        # repetition.
        self.warnings: dict[str, None] = {}
        self._scenes: dict[Path, Scene] = {}
        self.describe_views = cache(self._views)
        self.find_renders = cache(lambda folder, at: find_renders(folder, at.read().test))
        self.hash_file = cache(_hash)
        self.hash_metrics = cache(hash_metrics)
        self.describe_renderer = cache(_describe_renderer)
        self.hash_walk = cache(_hash_walk)

    def _views(self, at: SceneAt) -> ViewState:
        return describe_views(self.read_scene(at))

    def read_scene(self, at: SceneAt) -> Scene:
        """Return a scene, and collect its warnings."""
        scene = at.read()
        lines = (warning.to_line(warning.file or scene.root) for warning in scene.warnings)
        self.warnings |= dict.fromkeys(lines)
        self._scenes[scene.root] = scene
        return scene

    def find_training_differences(
        self, model: ModelAsset | None, at: SceneAt, place: Path | None, *, held_out: bool
    ) -> Iterator[str]:
        """Yield a warning for each difference between a model's training and the evaluation.

        `place` is the path of the model. If only official renderings exist, `model` is None. `held_out` is
        the protocol key that confirms that the test views were not used for training.
        """
        notes: list[Finding] = []
        if model is not None:
            notes += compare_training(model.training, model.background, self.read_scene(at))
        if model is None or "eval" not in model.training:
            if held_out:
                yield VOUCHED
            else:
                notes.append(warn_unknown_split())
        for note in notes:
            self.warnings[note.to_line(place)] = None
            yield note.message

    def list_notes(self) -> list[str]:
        """Return the warnings, and a note on scenes whose images were resized."""
        note = note_scaled_cameras(self._scenes.values())
        return [*self.warnings, *([] if note is None else [note])]


def _hash(path: Path) -> str:
    """Return a short hash of a file, or an error code if it cannot be read.

    The error is reported when a part needs the file.
    """
    try:
        return file_sha256(path)[:_SHORT_DIGITS]
    except MsbError as error:
        return error.code


def find_inputs(job: Job, reader: InputReader) -> dict[PartName, PartInputs]:
    """Return the current inputs of each part that the protocol requests for a benchmark cell."""
    parts: dict[PartName, PartInputs] = {}
    condition = job.cell.condition
    views = {"cameras": job.views.cameras, "photographs": job.views.photographs}
    # An exported mesh is audited and not rendered. The protocol may also request trials, repairs and
    # measurements of the mesh.
    if condition == "exported_mesh":
        if job.model is not None:
            parts |= _find_mesh_inputs(job)
            if job.trial is not None and job.trial.compare:
                parts["repairs"] = _find_repair_inputs(job, job.trial)
        if job.cell.dataset == "dtu" and job.chamfer is not None:
            parts["chamfer"] = _find_chamfer_inputs(job, job.chamfer, reader)
    else:
        # All other conditions have images. Conditions that our renderers draw also have a timing and a walk
        # (a camera path).
        parts["quality"] = {
            **views,
            **_find_image_inputs(job, reader),
            "metrics": reader.hash_metrics(job.vgg_weights),
        }
        if job.walk is not None:
            parts["walk"] = {
                "flight": reader.hash_walk(job.scene, job.walk),
                **_find_image_inputs(job, reader),
                "definition": f"blur {BLUR:g}, reach {REACH}, depths {SAME:g}",
                "film": "mp4" if is_installed("av") else "none",
            }
        if condition != "non_engine" and job.timing.frames:
            parts["timing"] = {
                "cameras": job.views.cameras,
                **_find_image_inputs(job, reader),
                "device": _describe_device(reader.device),
                "clock": f"{job.timing.frames} frames, {job.timing.seconds:g} s",
            }
        if job.cell.bake is not None:
            parts |= _find_mesh_inputs(job)
    # Input files that the user provides. Only the method's own conditions have a training record. Variants,
    # engines and bakes have no training record.
    if job.training is not None and job.cell.condition_key == condition:
        parts["training"] = {"file": reader.hash_file(job.training)}
    if job.renderer_timing is not None:
        parts["renderer_timing"] = {"file": reader.hash_file(job.renderer_timing)}
    return parts


def _hash_walk(at: SceneAt, table: WalkTable) -> str:
    """Return a hash of the cameras and the background of a camera path (walk), or an error code."""
    scene = at.read()
    try:
        return digest([[describe_camera(camera) for camera in plan_walk(scene, table)], scene.background])
    except MsbError as error:  # the error is reported when the part is computed
        return error.code


def _find_mesh_inputs(job: Job) -> dict[PartName, PartInputs]:
    """Return the inputs of the audit and of the trial."""
    parts: dict[PartName, PartInputs] = {"audit": {"asset": _get_asset_hash(job), "tool": __version__}}
    if job.trial is not None:
        parts["trial"] = _find_trial_inputs(job, job.trial.tasks, job.trial)
    return parts


def _find_trial_inputs(job: Job, names: Sequence[str], table: TrialTable) -> PartInputs:
    """Return the inputs of a trial.

    Missing libraries are inputs. Therefore the trial is repeated after a library was installed.
    """
    from msb.trial.registry import missing_modules, select_tasks

    tasks = select_tasks(names)
    return {
        "asset": _get_asset_hash(job),
        "cameras": job.views.cameras,
        "tool": __version__,
        "tasks": ", ".join(task.name for task in tasks),
        "limits": f"{table.seconds:g} s, {table.memory:g} GiB",
        "missing": ", ".join(missing_modules(tasks)),
    }


def _find_repair_inputs(job: Job, table: TrialTable) -> PartInputs:
    """Return the inputs of the comparison of repairs."""
    from msb.repair.plan import BY_PEER
    from msb.trial.repairs import STRATEGIES

    inputs = _find_trial_inputs(job, list_compared_tasks(table), table)
    absent = [peer for peer in BY_PEER if not is_installed(peer)]
    missing = dict.fromkeys([*filter(None, inputs["missing"].split(", ")), *absent])
    return {**inputs, "strategies": "; ".join(STRATEGIES), "missing": ", ".join(missing)}


def _get_asset_hash(job: Job) -> str:
    assert job.model is not None
    return str(job.model.asset.sha256)[:_SHORT_DIGITS]


def _find_image_inputs(job: Job, reader: InputReader) -> PartInputs:
    """Return the inputs of the images of a benchmark cell, without cameras and background."""
    if job.renders is not None:
        try:
            return {"renders": str(reader.find_renders(job.renders, job.scene).folder.sha256)[:_SHORT_DIGITS]}
        except MsbError as error:  # the error is reported when the part is computed
            return {"renders": error.code}
    renderer = reader.describe_renderer(job.cell.renderer or job.tier)
    inputs = {"asset": _get_asset_hash(job), "settings": digest(dict(job.settings)), "renderer": renderer}
    return {**inputs, **job.options}


def _describe_renderer(name: str) -> str:
    """Return name and version of the renderer that is registered as `name`."""
    from msb.render.backend import find_renderer

    renderer: Any = find_renderer(name)
    installed = getattr(renderer, "installed", None)
    version = getattr(renderer, "version", "") if installed is None else installed()
    return f"{getattr(renderer, 'name', name)} {version}".rstrip()


def _describe_device(record: Mapping[str, Any] | None) -> str:
    """Return platform, name and driver of a device in one string."""
    if record is None:
        return "unknown"
    return " ".join(str(record[key]) for key in ("platform", "name", "driver"))


def find_scan_files(data: Path, scene: str) -> list[Path]:
    """Return the files of the DTU evaluation data for the Chamfer distance of a scene."""
    scan = parse_scan_number(scene)
    return [data / name.format(scan) for name in (_CLOUD, _GRID, _PLANE)]


def _find_chamfer_inputs(job: Job, table: ChamferTable, reader: InputReader) -> PartInputs:
    """Return the inputs of the Chamfer distance.

    A missing file is reported when the Chamfer distance is computed.
    """
    from msb.metrics import identity

    scene = job.scene.read()
    data: list[Path] = []
    masks: list[Path] = []
    with contextlib.suppress(MsbError):
        data = find_scan_files(Path(table.data), job.cell.scene)
        masks = find_mask_files(scene)
    about = identity("chamfer_dtu", seed=table.seed).to_dict()
    return {
        "mesh": _get_asset_hash(job) if job.mesh is None else reader.hash_file(job.mesh),
        "scan": digest([reader.hash_file(path) for path in data]),
        "views": digest([reader.hash_file(path) for path in (scene.root / "cameras.npz", *masks)]),
        "metric": digest(defined(about)),
    }
