"""Try tasks on a mesh: run their libraries in child processes, judge the results, and save them."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.look import written_up
from msb.base.atomic import new_file
from msb.base.extras import install
from msb.base.limits import Limits
from msb.base.origin import Origin, to_world
from msb.errors import AssetError, about, shorten
from msb.meshes import write_mesh
from msb.meshes.assets import fit_to_format
from msb.render.options import ViewKind
from msb.repair.assets import repair_mesh
from msb.repair.plan import Options, parse_plan
from msb.scenes import Camera
from msb.topology.weld import Weld, parse_weld
from msb.trial.attempts import run_attempt
from msb.trial.mesh import TrialMesh, prepare_mesh
from msb.trial.registry import missing_modules, select_installed, select_tasks
from msb.trial.renderings import Renderings
from msb.trial.task import Attempt, AttemptResult, Judgement, Numbers, Outcome, Output, Task, file_outcome
from msb.views import ChosenViews, choose_views

SCHEMA = "msb.trial/1"
# Minimum time limit of a fallback library in seconds, including its imports. A fallback library then returns
# a result even if --seconds is short.
FALLBACK_SECONDS = 20.0


@dataclass(frozen=True)
class Trial:
    """The result of a single task.

    Attributes
    ----------
    outcome : {"works", "care", "fails", "not_run"}
        "care" means that the task works with limitations. "not_run" means that a library is missing, images
        are missing, or every library crashed or exceeded its limits.
    why : str or None
        The reason if the outcome is not "works".
    seconds : float
        The total time of the libraries. If a library exceeded its time limit, the limit is added.
    numbers : dict
        The measurements, as JSON data.
    libraries : dict of str to str
        Versions of the libraries that returned a result.
    says : str
        A short text with the most important numbers.
    files, picture : tuple of str, str or None
        The names of the saved files, and the name of the saved image.
    """

    task: str
    title: str
    outcome: Outcome
    why: str | None
    seconds: float
    numbers: Numbers = field(default_factory=dict)
    libraries: dict[str, str] = field(default_factory=dict)
    says: str = ""
    files: tuple[str, ...] = ()
    picture: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the result of the task as JSON data."""
        return {**vars(self), "files": list(self.files)}


@dataclass(frozen=True)
class Trials:
    """The results of all tasks on a mesh.

    The field `mesh` has the numbers of vertices and faces, the distance of merged vertices ("weld"), the
    repair plan, and the SHA-256 hash of the mesh. The field `cameras` has the number of cameras ("count"),
    their origin ("from"), and their description ("views"). The origin is "given", "training", "turntable" or
    "inside". "see_nothing" is the number of cameras that do not see the mesh. If nothing was rendered,
    "no_pictures" is the reason.
    """

    path: str | None
    trials: tuple[Trial, ...]
    mesh: dict[str, Any]
    limits: dict[str, float | None]
    cameras: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return the results of all tasks as JSON data (schema msb.trial/1)."""
        trials = [trial.to_dict() for trial in self.trials]
        return {"schema": SCHEMA, **vars(self), "trials": trials}


def trial(
    asset: Asset | str | os.PathLike[str],
    tasks: Iterable[str] | str = (),
    *,
    weld: Weld | None = None,
    repair: Sequence[str] | str | None = None,
    cameras: Sequence[Camera] | None = None,
    limits: Limits | None = None,
    device: str | None = None,
) -> list[Trial]:
    """Try typical tasks of artists on a mesh. Each task runs its usual library.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or a path that `msb.open` accepts.
    tasks : iterable of str, or str
        Names of tasks, or words of names: "decimate" selects "decimate_50", "decimate_25" and "decimate_10".
        A string may contain several names, separated by commas. Default: all tasks (docs/trial.md).
    weld : "exact" or float, optional
        Before the tasks, merge vertices with equal coordinates, or vertices within this distance.
    repair : sequence of str, or str, optional
        Repair the mesh with this plan, after `weld` and before all tasks; see `msb.repair`.
    cameras : sequence of Camera, optional
        The views for judging results, at least one. The default is the training views if they are stored in
        the same folder, else eight views around or inside the mesh (docs/cameras.md).
    limits : Limits, optional
        Time and memory limits of each library for each task. Default: 60 s and 4 GiB.
    device : str, optional
        The OpenCL device for rendering.

    Returns
    -------
    list of Trial
        In the order of `msb.trial.registry.TASKS`.

    Raises
    ------
    UsageError
        A task or a repair step is unknown, a limit is invalid, or `cameras` is empty.
    AssetError
        A coordinate is not finite, an index is out of range, or the repair left no face.
    InputError, CheckpointError, MeshFileError, MeshError, Unsupported
        The file cannot be read, or the weld is invalid.

    Examples
    --------
    >>> import msb
    >>> (solid,) = msb.trial("data_stubs/splat_like.triasset", ["solid"])
    >>> solid.outcome
    'fails'
    """
    results = try_asset(
        as_asset(asset),
        tasks,
        weld=weld,
        repair=repair,
        cameras=cameras,
        limits=limits,
        device=device,
    )
    return list(results.trials)


def try_asset(
    asset: Asset,
    tasks: Iterable[str] | str = (),
    *,
    weld: Weld | None = None,
    repair: Sequence[str] | str | None = None,
    cameras: ChosenViews | Sequence[Camera] | None = None,
    view_kind: ViewKind | None = None,
    limits: Limits | None = None,
    device: str | None = None,
    keep: Path | None = None,
    meshes: bool = True,
    watch: Callable[[Trial], None] = lambda _: None,
) -> Trials:
    """Try tasks on an asset. See `trial` for the other parameters.

    The argument `view_kind` selects the generated views, as in `msb.views.choose_views`.

    The argument `keep` is the folder for results. An image of each task is saved in this folder. With
    `meshes`, the results are also saved as GLB files. The argument `watch` is called with the result of each
    task.
    """
    selected = select_tasks(tasks)
    limits = Limits() if limits is None else limits
    weld = None if weld is None else parse_weld(weld)
    plan = None if repair is None else parse_plan(repair)
    # Prepare the mesh and its renderings, relative to the origin of the asset.
    mesh, origin = prepare_mesh(asset, weld), asset.manifest.origin
    if plan is not None:
        with about(asset.path):
            mesh = _repair(mesh, plan)
    views = choose_views(asset, cameras, size=(960, 720), device=device, kind=view_kind)
    renderings = Renderings(mesh, views.relative_to(origin), device)
    results, up = [], written_up(asset)
    for task in selected:
        results.append(_TaskRun(task, mesh, renderings, limits, up, origin).run(keep, meshes=meshes))
        watch(results[-1])
    # Describe the cameras and the tried mesh.
    seen_by: dict[str, Any] = {
        "count": len(renderings.cameras),
        "from": views.origin,
        "views": views.description,
    }
    seen_by |= {"see_nothing": renderings.blind_cameras} if renderings.blind_cameras else {}
    seen_by |= {} if renderings.why_not is None else {"no_pictures": renderings.why_not}
    tried = {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "weld": weld,
        "repair": None if plan is None else list(plan.plan),
        "sha256": mesh.sha256,
    }
    path = None if asset.path is None else str(asset.path)
    return Trials(path, tuple(results), tried, limits.to_dict(), seen_by)


def _repair(mesh: TrialMesh, options: Options) -> TrialMesh:
    """Return the repaired mesh. Raise TRIASSET_EMPTY if no face is left."""
    repaired, _ = repair_mesh(mesh.to_mesh(), options)
    if not len(repaired.faces):
        text = f"the repair {','.join(options.plan)} removed all faces of the mesh"
        raise AssetError("TRIASSET_EMPTY", text)
    assert repaired.vertex_colors is not None
    return TrialMesh(repaired.vertices, repaired.faces, repaired.vertex_colors)


class _TaskRun:
    """A single task on a mesh, whose coordinates are relative to `origin`."""

    def __init__(
        self,
        task: Task,
        mesh: TrialMesh,
        renderings: Renderings,
        limits: Limits,
        up: str | None,
        origin: Origin,
    ) -> None:
        self.task, self.mesh, self.renderings, self.limits = task, mesh, renderings, limits
        self.up, self.origin = up, origin

    def run(self, keep: Path | None, *, meshes: bool) -> Trial:
        """Run the attempts, judge and save their outputs, and return the result of the task."""
        task = self.task
        absent = missing_modules([task])
        missing = f"{' and '.join(absent)} not installed: {install('trial')}" if absent else ""
        if not select_installed(task.attempts):
            return Trial(task.name, task.title, "not_run", missing, 0.0)
        # Run the attempts. If all attempts fail, run the fallback libraries.
        arrays = task.prepare(self.mesh, self.renderings) if task.prepare else {}
        replies = self.run_attempts(task.attempts, arrays, self.limits)
        if not any(reply.output for reply in replies.values()):
            patient = replace(self.limits, seconds=max(self.limits.seconds, FALLBACK_SECONDS))
            replies |= self.run_attempts(task.fallbacks, arrays, patient)
        outputs = {name: reply.output for name, reply in replies.items() if reply.output is not None}
        # Judge the outputs, save them, and include the audit of the result.
        judgement = self.judge(replies, outputs)
        files, picture = self.save(keep, outputs, meshes=meshes)
        summary = task.summarize(judgement.numbers) if outputs else ""
        judgement, summary = self.add_file_verdict(judgement, summary, outputs, files)
        reasons = (judgement.why, missing if judgement.outcome != "works" else "")
        return Trial(
            task.name,
            task.title,
            judgement.outcome,
            "; ".join(filter(None, reasons)) or None,
            sum(reply.seconds or 0.0 for reply in replies.values()),
            judgement.numbers,
            {name: reply.version for name, reply in replies.items() if reply.version is not None},
            summary,
            files,
            picture,
        )

    def run_attempts(
        self, attempts: Iterable[Attempt], arrays: Mapping[str, NDArray[Any]], limits: Limits
    ) -> dict[str, AttemptResult]:
        """Run the attempts whose libraries are installed.

        The verdicts on the resulting meshes are added to the numbers.
        """
        replies = {
            attempt.library: run_attempt(self.task, attempt, self.mesh, arrays, limits)
            for attempt in select_installed(attempts)
        }
        for output in filter(None, (reply.output for reply in replies.values())):
            for mesh in output.meshes.values():
                verdict = {"level": mesh.verdict.level, "sentence": mesh.verdict.sentence}
                output.numbers["verdict"] = verdict
        return replies

    def judge(self, replies: dict[str, AttemptResult], outputs: dict[str, Output]) -> Judgement:
        """Return the judgement of the task with the reasons of failed attempts."""
        failed = {name: reply for name, reply in replies.items() if reply.output is None}
        why = "; ".join(f"{name}: {reply.why}" for name, reply in failed.items())
        numbers: Numbers = {}
        if failed:
            numbers["failed"] = {
                name: {"why": reply.why, "ended_by": reply.ended_by, "seconds": reply.seconds}
                for name, reply in failed.items()
            }
        if not outputs:
            # Crashes and exceeded limits may be faults of the library.
            ended = any(reply.ended_by is not None for reply in failed.values())
            return Judgement("not_run" if ended else "fails", why, numbers)
        judgement = self.task.judge(self.mesh, outputs, self.renderings)
        # The mesh may be correct although all main libraries crashed or exceeded their limits. In this
        # case, the outcome is not "fails".
        ended = all(
            replies[attempt.library].ended_by is not None
            for attempt in self.task.attempts
            if attempt.library in replies
        )
        if ended and judgement.outcome == "fails":
            judgement = replace(judgement, outcome="not_run")
        no_images = self.renderings.why_not
        if self.task.needs_images and judgement.outcome != "fails" and no_images is not None:
            judgement = Judgement("not_run", f"cannot be judged: {no_images}", judgement.numbers)
        reason = "; ".join(filter(None, (why, judgement.why))) or None
        return Judgement(judgement.outcome, reason, {**judgement.numbers, **numbers})

    def add_file_verdict(
        self, judgement: Judgement, summary: str, outputs: dict[str, Output], files: Sequence[str]
    ) -> tuple[Judgement, str]:
        """Return the judgement and the summary.

        Both results contain the verdict on the best resulting mesh. If this verdict is BAD, or worse than the
        verdict on the original, the best possible outcome is "works with limitations".
        """
        best = judgement.numbers.get("best", next(iter(outputs), ""))
        for key, mesh in outputs[best].meshes.items() if best else ():
            result, original = mesh.verdict, self.mesh.verdict
            name = self.file_name(best, key)
            without_seams = " (seams merged)" if mesh.uv is not None else ""
            text = f"{name if name in files else 'the result'}{without_seams} is {result.word}"
            if result.reason:
                text += " like the original" if result.level == original.level else f" ({result.reason})"
            if judgement.outcome == "works" and file_outcome(self.mesh, mesh) != "works":
                text += (
                    ""
                    if result.level == original.level
                    else f"; the verdict on the original is {original.word}"
                )
                reason = "; ".join(filter(None, (judgement.why, text)))
                judgement = Judgement("care", reason, judgement.numbers)
            elif judgement.why and not summary:  # Fallback libraries have no summary.
                judgement = replace(judgement, why=f"{judgement.why}; {text}")
            else:
                summary = "; ".join(filter(None, (summary, text)))
        return judgement, summary

    def file_name(self, library: str, key: str) -> str:
        """Return the file name for the mesh with this `key` from a library."""
        libraries = [attempt.library for attempt in self.task.attempts]
        part = key if library not in libraries else library if len(libraries) > 1 else ""
        return f"{'-'.join(filter(None, (self.task.name, part)))}.glb"

    def save(
        self, folder: Path | None, outputs: dict[str, Output], *, meshes: bool
    ) -> tuple[tuple[str, ...], str | None]:
        """If there is a folder, save the image of the task. With `meshes`, also save the meshes.

        Return the names of the saved files, and the name of the saved image.
        """
        if folder is None:
            return (), None
        files = []
        for library, output in outputs.items() if meshes else ():
            for key, mesh in output.meshes.items():
                if len(mesh.faces):
                    files.append(self.file_name(library, key))
                    with new_file(folder / files[-1]) as stream:
                        vertices = to_world(mesh.vertices, self.origin)
                        placed = replace(mesh.to_mesh(), vertices=vertices, up=self.up)
                        write_mesh(fit_to_format(placed, ".glb"), stream, suffix=".glb")
        draw = self.task.picture
        image = draw(self.mesh, outputs, self.renderings) if draw and outputs else None
        if image is None:
            return tuple(files), None
        picture = f"{self.task.name}.png"
        _write_picture(folder / picture, image)
        return (*files, picture), picture


def _write_picture(path: Path, image: NDArray[Any]) -> None:
    """Write an image (H, W, 3) as a PNG file."""
    from PIL import Image

    with new_file(path) as stream:
        Image.fromarray(image).save(stream, "PNG", optimize=True)


def summarize_trials(trials: Iterable[Trial]) -> str:
    """Return a text with the numbers of tasks by outcome, worst first: "3 fail: uv, boolean, solid; 2 work:
    ..."."""
    verbs = {"fails": "fail", "care": "work with limitations", "not_run": "not run", "works": "work"}
    parts = []
    for outcome, verb in verbs.items():
        names = [trial.task for trial in trials if trial.outcome == outcome]
        if names:
            parts.append(f"{len(names)} {verb}: {', '.join(names)}")
    return shorten("; ".join(parts), 400)
