"""Try tasks on a mesh: libraries in child processes, judged by pictures, kept as files if that is wanted."""

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
from msb.errors import AssetError, about, shorten
from msb.meshes import write_mesh
from msb.meshes.assets import as_held
from msb.repair.assets import repair_mesh
from msb.repair.plan import Options, parse_plan
from msb.scenes import Camera
from msb.topology.weld import Weld, parse_weld
from msb.trial.attempts import run_attempt
from msb.trial.renderings import Look
from msb.trial.mesh import TriedMesh, mesh_to_try
from msb.trial.registry import able, chosen_tasks, missing_modules
from msb.trial.task import Attempt, Attempted, Judgement, Made, Numbers, Outcome, Task, file_outcome
from msb.views import Views, choose_views

SCHEMA = "msb.trial/1"
# Least time of a substitute for a library, imports included, so that something is made.
INSTEAD_SECONDS = 20.0


@dataclass(frozen=True)
class Trial:
    """What became of one task.

    Attributes
    ----------
    outcome : {"works", "care", "fails", "not_run"}
        "care" works with something to watch; "not_run" lacks a library.
    why : str or None
        Why it is not better.
    seconds : float
        The time that the libraries took; that of a library that was ended is its limit.
    numbers : dict
        What was measured, as JSON has it.
    libraries : dict of str to str
        Library -> version, of those that answered.
    says : str
        The numbers in a few words.
    files, picture : tuple of str, str or None
        The names of the files that were kept, and of the picture among them.
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
        """Return it as JSON data."""
        return {**vars(self), "files": list(self.files)}


@dataclass(frozen=True)
class Trials:
    """What became of all tasks on one mesh.

    `mesh` has the numbers of vertices and faces, the weld, the plan of the repair, and the SHA-256 of what
    was tried. `cameras` says how many there were, where they are "from" ("given", "training", "turntable",
    "inside"), and the same in words; how many "see_nothing" of the mesh, and why there are "no_pictures",
    where that is so.
    """

    path: str | None
    trials: tuple[Trial, ...]
    mesh: dict[str, Any]
    limits: dict[str, float | None]
    cameras: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data (schema msb.trial/1)."""
        trials = [one.to_dict() for one in self.trials]
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
    """Try tasks on a mesh with the libraries that artists use, and return what became of them.

    Parameters
    ----------
    asset : Asset or path-like
        Or the path of anything that `msb.open` takes.
    tasks : iterable of str, or str
        Names of tasks, or words of names: "decimate" is "decimate_50", "decimate_25" and "decimate_10". A
        string holds names between commas. All, if there are none; docs/trial.md describes them.
    weld : "exact" or float, optional
        Merge coincident vertices first.
    repair : sequence of str, or str, optional
        The plan of a repair that is made first, as `msb.repair` takes it; after the weld.
    cameras : sequence of Camera, optional
        Where the mesh is looked at from, at least one; those of its training where they lie beside the path,
        else eight views round it, or inside it, if not given (docs/trial.md).
    limits : Limits, optional
        What each library may take for each task; 60 s and 4 GiB if not given.
    device : str, optional
        The OpenCL device that draws.

    Returns
    -------
    list of Trial
        In the order of `msb.trial.registry.TASKS`.

    Raises
    ------
    UsageError
        There is no such task, no such step of a repair, or no camera, or the limits are none.
    AssetError
        A coordinate is not finite, an index is out of range, or the repair left no face.
    InputError, CheckpointError, MeshFileError, MeshError, Unsupported
        The path cannot be read, or the weld is none.

    Examples
    --------
    >>> import msb
    >>> (solid,) = msb.trial("data_stubs/splat_like.triasset", ["solid"])
    >>> solid.outcome
    'fails'
    """
    tried = try_asset(
        as_asset(asset),
        tasks,
        weld=weld,
        repair=repair,
        cameras=cameras,
        limits=limits,
        device=device,
    )
    return list(tried.trials)


def try_asset(
    asset: Asset,
    tasks: Iterable[str] | str = (),
    *,
    weld: Weld | None = None,
    repair: Sequence[str] | str | None = None,
    cameras: Views | Sequence[Camera] | None = None,
    limits: Limits | None = None,
    device: str | None = None,
    keep: Path | None = None,
    meshes: bool = True,
    watch: Callable[[Trial], None] = lambda _: None,
) -> Trials:
    """Return what became of the tasks, and what they were tried on; parameters as for `trial`.

    The folder `keep` gets a picture of each task and, with `meshes`, what was made, as GLB. `watch` is called
    with each task's outcome.
    """
    chosen = chosen_tasks(tasks)
    limits = Limits() if limits is None else limits
    weld = None if weld is None else parse_weld(weld)
    plan = None if repair is None else parse_plan(repair)
    mesh = mesh_to_try(asset, weld)
    if plan is not None:
        with about(asset.path):
            mesh = _repaired(mesh, plan)
    views = choose_views(asset, cameras, size=(960, 720), device=device)
    look = Look(mesh, views, device)
    found, up = [], written_up(asset)
    for task in chosen:
        found.append(_Trying(task, mesh, look, limits, up).run(keep, meshes=meshes))
        watch(found[-1])
    seen_by: dict[str, Any] = {"count": len(look.cameras), "from": views.origin, "views": views.said}
    seen_by |= {"see_nothing": look.unseeing} if look.unseeing else {}
    seen_by |= {} if look.why_not is None else {"no_pictures": look.why_not}
    tried = {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "weld": weld,
        "repair": None if plan is None else list(plan.plan),
        "sha256": mesh.sha256,
    }
    of = None if asset.path is None else str(asset.path)
    return Trials(of, tuple(found), tried, limits.to_dict(), seen_by)


def _repaired(mesh: TriedMesh, options: Options) -> TriedMesh:
    made, _ = repair_mesh(mesh.to_mesh(), options)
    if not len(made.faces):
        text = f"the repair {','.join(options.plan)} left no face to try anything on"
        raise AssetError("TRIASSET_EMPTY", text)
    assert made.vertex_colors is not None
    return TriedMesh(made.vertices, made.faces, made.vertex_colors)


class _Trying:
    """One task on one mesh."""

    def __init__(self, task: Task, mesh: TriedMesh, look: Look, limits: Limits, up: str | None) -> None:
        self.task, self.mesh, self.look, self.limits, self.up = task, mesh, look, limits, up

    def run(self, keep: Path | None, *, meshes: bool) -> Trial:
        """Make the attempts, judge them, and keep what is wanted."""
        task = self.task
        absent = missing_modules([task])
        lacks = f"{' and '.join(absent)} not installed: {install('trial')}" if absent else ""
        if not able(task.attempts):
            return Trial(task.name, task.title, "not_run", lacks, 0.0)
        arrays = task.prepare(self.mesh, self.look) if task.prepare else {}
        replies = self.replies(task.attempts, arrays, self.limits)
        if not any(reply.made for reply in replies.values()):
            patient = replace(self.limits, seconds=max(self.limits.seconds, INSTEAD_SECONDS))
            replies |= self.replies(task.instead, arrays, patient)
        made = {name: reply.made for name, reply in replies.items() if reply.made is not None}
        judged = self.judged(replies, made)
        files, picture = self.kept(keep, made, meshes=meshes)
        said = task.says(judged.numbers) if made else ""
        judged, said = self.with_file(judged, said, made, files)
        return Trial(
            task.name,
            task.title,
            judged.outcome,
            "; ".join(filter(None, (judged.why, lacks if judged.outcome != "works" else ""))) or None,
            sum(reply.seconds or 0.0 for reply in replies.values()),
            judged.numbers,
            {name: reply.version for name, reply in replies.items() if reply.version is not None},
            said,
            files,
            picture,
        )

    def replies(
        self, attempts: Iterable[Attempt], arrays: Mapping[str, NDArray[Any]], limits: Limits
    ) -> dict[str, Attempted]:
        """Make those attempts whose libraries are installed; audit what they made."""
        found = {
            one.library: run_attempt(self.task, one, self.mesh, arrays, limits) for one in able(attempts)
        }
        for made in filter(None, (reply.made for reply in found.values())):
            for mesh in made.meshes.values():
                made.numbers["verdict"] = {"level": mesh.verdict.level, "sentence": mesh.verdict.sentence}
        return found

    def judged(self, replies: dict[str, Attempted], made: dict[str, Made]) -> Judgement:
        """Return the task's own judgement, with what is to be said of attempts that failed."""
        failed = {name: reply for name, reply in replies.items() if reply.made is None}
        why = "; ".join(f"{name}: {reply.why}" for name, reply in failed.items())
        numbers: Numbers = {}
        if failed:
            numbers["failed"] = {
                name: {"why": reply.why, "ended_by": reply.ended_by, "seconds": reply.seconds}
                for name, reply in failed.items()
            }
        if not made:
            return Judgement("fails", why, numbers)
        judged = self.task.judge(self.mesh, made, self.look)
        if self.task.by_look and judged.outcome != "fails" and self.look.why_not is not None:
            judged = Judgement("not_run", f"not judged: {self.look.why_not}", judged.numbers)
        reason = "; ".join(filter(None, (why, judged.why))) or None
        return Judgement(judged.outcome, reason, {**judged.numbers, **numbers})

    def with_file(
        self, judged: Judgement, said: str, made: dict[str, Made], files: Sequence[str]
    ) -> tuple[Judgement, str]:
        """Return the judgement and what is said, with the verdict of the file that counts."""
        best = judged.numbers.get("best", next(iter(made), ""))
        for key, mesh in made[best].meshes.items() if best else ():
            own, given = mesh.verdict, self.mesh.verdict
            name = self.file(best, key)
            aside = ", seams aside," if mesh.uv is not None else ""
            text = f"{name if name in files else 'the file'} is{aside} {own.word}"
            if own.reason:
                text += " as the mesh was" if own.level == given.level else f" ({own.reason})"
            if judged.outcome == "works" and file_outcome(self.mesh, mesh) != "works":
                text += "" if own.level == given.level else f"; the mesh was {given.word}"
                judged = Judgement("care", "; ".join(filter(None, (judged.why, text))), judged.numbers)
            elif judged.why and not said:  # nothing is said before why another shape stands in
                judged = replace(judged, why=f"{judged.why}; {text}")
            else:
                said = "; ".join(filter(None, (said, text)))
        return judged, said

    def file(self, library: str, key: str) -> str:
        """Return the name of the file that is kept of what a library made."""
        first = [one.library for one in self.task.attempts]
        own = key if library not in first else library if len(first) > 1 else ""
        return f"{'-'.join(filter(None, (self.task.name, own)))}.glb"

    def kept(
        self, folder: Path | None, made: dict[str, Made], *, meshes: bool
    ) -> tuple[tuple[str, ...], str | None]:
        """Write what is to be kept; return the names of the files, and of the picture among them."""
        if folder is None:
            return (), None
        files = []
        for library, one in made.items() if meshes else ():
            for key, mesh in one.meshes.items():
                if len(mesh.faces):
                    files.append(self.file(library, key))
                    with new_file(folder / files[-1]) as stream:
                        upright = as_held(replace(mesh.to_mesh(), up=self.up), ".glb")
                        write_mesh(upright, stream, suffix=".glb")
        image = self.task.picture(self.mesh, made, self.look) if self.task.picture and made else None
        if image is None:
            return tuple(files), None
        picture = f"{self.task.name}.png"
        _write_picture(folder / picture, image)
        return (*files, picture), picture


def _write_picture(path: Path, image: NDArray[Any]) -> None:
    from PIL import Image

    with new_file(path) as stream:
        Image.fromarray(image).save(stream, "PNG", optimize=True)


def summary(trials: Iterable[Trial]) -> str:
    """Return how many tasks came to what, worst first: "3 fail: uv, boolean, solid; 2 work"."""
    verbs = {"fails": "fail", "care": "work with care", "not_run": "not run", "works": "work"}
    parts = []
    for outcome, verb in verbs.items():
        names = [one.task for one in trials if one.outcome == outcome]
        if names:
            parts.append(f"{len(names)} {verb}: {', '.join(names)}")
    return shorten("; ".join(parts), 400)
