"""The inputs that decide each part of a cell, as hashes and versions; if one changes, the part is redone.

Library versions are in the records and not here: an update of NumPy is no reason to render everything again.
The device decides timings only: images agree between devices, and a record names the one that drew it.
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
from msb.bench.job import Inputs, Job, Part
from msb.bench.models import Model
from msb.bench.parts import compared_tasks, mask_files, scan_number
from msb.bench.photographs import Views, numbers_of, views_of
from msb.bench.protocol_tables import ChamferTable, TrialTable, WalkTable
from msb.bench.quality import metrics_digest
from msb.bench.renders import find_renders
from msb.bench.walk import flight
from msb.errors import MsbError
from msb.metrics.identity import defined
from msb.metrics.steadiness import BLUR, REACH, SAME
from msb.scenes.datasets import Scene, SceneAt, scaled_note, trained_otherwise

_SHORT = 16
_CLOUD, _GRID, _PLANE = "Points/stl/stl{:03d}_total.ply", "ObsMask/ObsMask{}_10.mat", "ObsMask/Plane{}.mat"


class Known:
    """Facts that are read once for a whole plan; `device` is the record of the OpenCL device, if any."""

    def __init__(self, device: Mapping[str, Any] | None = None) -> None:
        self.device = device
        self.warnings: dict[str, None] = {}
        """Lines about the scenes read, and about records that are not valid, as keys."""
        self._scenes: dict[Path, Scene] = {}
        self.views = cache(self._views)
        self.renders = cache(lambda folder, at: find_renders(folder, at.read().test))
        self.hash = cache(_hash)
        self.metrics = cache(metrics_digest)
        self.renderer = cache(_renderer)
        self.flight = cache(_flight)

    def _views(self, at: SceneAt) -> Views:
        return views_of(self.scene(at))

    def scene(self, at: SceneAt) -> Scene:
        """Return a scene; remember what it warns of."""
        scene = at.read()
        lines = (one.to_line(one.file or scene.root) for one in scene.warnings)
        self.warnings |= dict.fromkeys(lines)
        self._scenes[scene.root] = scene
        return scene

    def trained(self, model: Model, at: SceneAt, place: Path | None) -> Iterator[str]:
        """Yield what the model's training did otherwise, and remember it as a warning about `place`."""
        for note in trained_otherwise(model.training, model.background, self.scene(at)):
            self.warnings[note.to_line(place)] = None
            yield note.message

    def notes(self) -> list[str]:
        """Return what the user should know of all that was read."""
        note = scaled_note(self._scenes.values())
        return [*self.warnings, *([] if note is None else [note])]


def _hash(path: Path) -> str:
    """Return a short hash of a file; one that cannot be read has none, and says so when it is used."""
    try:
        return file_sha256(path)[:_SHORT]
    except MsbError as error:
        return error.code


def inputs_of(job: Job, known: Known) -> dict[Part, Inputs]:
    """Return the present inputs of each part that the job's cell should have."""
    parts: dict[Part, Inputs] = {}
    condition = job.cell.condition
    views = {"cameras": job.views.cameras, "photographs": job.views.photographs}
    if condition == "exported_mesh":
        if job.model is not None:
            parts |= _of_mesh(job)
            if job.trial is not None and job.trial.compare:
                parts["repairs"] = _repairs(job, job.trial)
        if job.cell.dataset == "dtu" and job.chamfer is not None:
            parts["chamfer"] = _chamfer(job, job.chamfer, known)
    else:
        parts["quality"] = {**views, **_images(job, known), "metrics": known.metrics(job.vgg_weights)}
        if job.walk is not None:
            parts["walk"] = {
                "flight": known.flight(job.scene, job.walk),
                **_images(job, known),
                "definition": f"blur {BLUR:g}, reach {REACH}, depths {SAME:g}",
                "film": "mp4" if is_installed("av") else "none",
            }
        if condition != "non_engine" and job.timing.frames:
            parts["timing"] = {
                "cameras": job.views.cameras,
                **_images(job, known),
                "device": _device(known.device),
                "clock": f"{job.timing.frames} frames, {job.timing.seconds:g} s",
            }
        if job.cell.bake is not None:
            parts |= _of_mesh(job)
    if job.training is not None and job.cell.condition_key == condition:
        parts["training"] = {"file": known.hash(job.training)}
    if job.renderer_timing is not None:
        parts["renderer_timing"] = {"file": known.hash(job.renderer_timing)}
    return parts


def _flight(at: SceneAt, wanted: WalkTable) -> str:
    """Return a hash of the cameras of a walk and of what is behind the model."""
    scene = at.read()
    try:
        return digest([[numbers_of(camera) for camera in flight(scene, wanted)], scene.background])
    except MsbError as error:  # the part will say it again, and in full
        return error.code


def _of_mesh(job: Job) -> dict[Part, Inputs]:
    """Return what decides the parts about a mesh as it is stored."""
    parts: dict[Part, Inputs] = {"audit": {"asset": _asset(job), "tool": __version__}}
    if job.trial is not None:
        parts["trial"] = _trial(job, job.trial.tasks, job.trial)
    return parts


def _trial(job: Job, names: Sequence[str], wanted: TrialTable) -> Inputs:
    """Return what decides the trials; a library that was missing and is there now is such a thing, too."""
    from msb.trial.registry import chosen_tasks, missing_modules

    tasks = chosen_tasks(names)
    return {
        "asset": _asset(job),
        "cameras": job.views.cameras,
        "tool": __version__,
        "tasks": ", ".join(task.name for task in tasks),
        "limits": f"{wanted.seconds:g} s, {wanted.memory:g} GiB",
        "missing": ", ".join(missing_modules(tasks)),
    }


def _repairs(job: Job, wanted: TrialTable) -> Inputs:
    """Return what decides the comparison of repairs."""
    from msb.repair.plan import BY_PEER
    from msb.trial.repairs import STRATEGIES

    inputs = _trial(job, compared_tasks(wanted), wanted)
    absent = [peer for peer in BY_PEER if not is_installed(peer)]
    missing = dict.fromkeys([*filter(None, inputs["missing"].split(", ")), *absent])
    return {**inputs, "strategies": "; ".join(STRATEGIES), "missing": ", ".join(missing)}


def _asset(job: Job) -> str:
    assert job.model is not None
    return str(job.model.asset.sha256)[:_SHORT]


def _images(job: Job, known: Known) -> Inputs:
    """Return what decides the cell's images, besides cameras and background."""
    if job.renders is not None:
        try:
            return {"renders": str(known.renders(job.renders, job.scene).folder.sha256)[:_SHORT]}
        except MsbError as error:  # the cell will say it again, and in full
            return {"renders": error.code}
    renderer = known.renderer(job.cell.renderer or job.tier)
    inputs = {"asset": _asset(job), "settings": digest(dict(job.settings)), "renderer": renderer}
    return {**inputs, **job.options}


def _renderer(name: str) -> str:
    from msb.render.backend import find_renderer

    made: Any = find_renderer(name)
    installed = getattr(made, "installed", None)
    version = getattr(made, "version", "") if installed is None else installed()
    return f"{getattr(made, 'name', name)} {version}".rstrip()


def _device(record: Mapping[str, Any] | None) -> str:
    if record is None:
        return "unknown"
    return " ".join(str(record[key]) for key in ("platform", "name", "driver"))


def scan_files(data: Path, scene: str) -> list[Path]:
    """Return the files of the official evaluation data that the Chamfer distance on a DTU scene needs."""
    scan = scan_number(scene)
    return [data / name.format(scan) for name in (_CLOUD, _GRID, _PLANE)]


def _chamfer(job: Job, wanted: ChamferTable, known: Known) -> Inputs:
    from msb.metrics import identity

    scene = job.scene.read()
    data: list[Path] = []
    masks: list[Path] = []
    with contextlib.suppress(MsbError):  # the part will say it again, and in full
        data = scan_files(Path(wanted.data), job.cell.scene)
        masks = mask_files(scene)
    about = identity("chamfer_dtu", seed=wanted.seed).to_dict()
    return {
        "mesh": _asset(job) if job.mesh is None else known.hash(job.mesh),
        "scan": digest([known.hash(path) for path in data]),
        "views": digest([known.hash(path) for path in (scene.root / "cameras.npz", *masks)]),
        "metric": digest(defined(about)),
    }
