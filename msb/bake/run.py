"""A bake from end to end: views, teacher, what is made of the faces, and what is measured of it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from msb.api.auditing import audit
from msb.api.opening import as_asset
from msb.bake.cache import SUFFIX
from msb.bake.collision import kind_of
from msb.bake.collision import need_libraries as need_for_shape
from msb.bake.folder import only_folder, write_folder
from msb.bake.lods import checked_shares
from msb.bake.making import Bake
from msb.bake.options import Options, Wanted, need_libraries
from msb.bake.preview import Preview, preview
from msb.bake.report import WORSE, Look, Report, Shape, Verdict
from msb.bake.teacher import Source, Teacher
from msb.bake.views import bake_views
from msb.bake.written import Part, endings, write_all
from msb.base.atomic import check_place, room_for_temporaries
from msb.base.paths import given_path
from msb.cl.devices import choose_device
from msb.errors import about
from msb.meshes.assets import asset_from_mesh

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False, repr=False)
class Baked:
    """A plain asset, and what it lost.

    Attributes
    ----------
    asset : Asset
        Of method "mesh", with a texture or colours of vertices; in memory.
    report : Report
        `print` shows it in a line, `to_dict` returns what `msb bake --json` writes.
    preview : Preview
        A picture of what was lost.
    lods : tuple of Asset
        Its levels of detail, the finest first.
    collision : Asset or None
        A shape to bump into, without colours.
    """

    asset: Asset
    report: Report
    preview: Preview
    lods: tuple[Asset, ...] = ()
    collision: Asset | None = None

    def save(self, *paths: str | os.PathLike[str], overwrite: bool = False) -> Report:
        """Write it in the formats that the suffixes name, all files or none; return the report on the first.

        A GLB has the report's main numbers in its `asset.extras`. Levels of detail and the collision shape
        stand beside each: NAME_lod1, NAME_lod2, ..., NAME_collision.

        A path without a suffix, or of a folder that is there, is a folder for all of it, which is the only
        path then: asset.glb and what stands beside it, bake.json, preview.png and the page index.html. Of a
        folder that is there nothing is replaced but what a bake wrote."""
        is_convex = self.report.collision is not None and self.report.collision.kind != "mesh"
        beside = self.lods if self.collision is None else (*self.lods, self.collision)
        main, *names = endings(len(self.lods), has_collision=self.collision is not None)
        parts = [Part(main, self.asset, self.report.extras(), self.collision, is_convex)]
        parts += [Part(name, one, {}) for name, one in zip(names, beside, strict=True)]
        places = [Path(path) for path in paths]
        if only_folder(places):
            return write_folder(self, parts, places[0], overwrite)
        return self.report.written(write_all(parts, places, overwrite))

    def __repr__(self) -> str:
        return f"<Baked, {self.report.geometry}: {self.report.sentence}>"


def bake(
    asset: Asset | str | os.PathLike[str],
    *,
    scene: Scene | str | os.PathLike[str] | None = None,
    cameras: Iterable[Camera] | None = None,
    geometry: Wanted = "auto",
    for_solid: bool = False,
    color: Look | None = None,
    teacher: Source = "dedicated",
    faces: int | None = None,
    texture: int | None = None,
    lods: Sequence[float] = (),
    collision: str | None = None,
    seconds: float = 60.0,
    seed: int = 0,
    up: str | None = None,
    background: Sequence[float] | str | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    keep_best: bool = False,
    cache: str | os.PathLike[str] | None = None,
) -> Baked:
    """Make a plain, opaque asset that looks like a model, taught by the model's own renderer.

    Parameters
    ----------
    asset : Asset or path-like
        The model, or the path of anything that `msb.open` takes. It is not changed.
    scene : Scene or path-like, optional
        The scene it was trained on: its training views teach, its test views are for the report alone.
    cameras : iterable of Camera, optional
        Views instead of a scene's; every 8th is for the report alone. Default: those of the training where
        they lie beside the model, else 40 views round it or inside it. Where fewer than 40 teach, the model
        is drawn between them as well.
    geometry : {"auto", "kept", "fitted", "surface"}
        The model's own triangles, triangles that were moved until the opaque picture is right, or one closed
        surface, which tools for solids can use. "auto" makes the first two, and takes what looks better in
        views that taught neither.
    for_solid : bool
        With "auto": make fitted triangles and a surface, and take the surface, unless its verdict is bad. A
        plain mesh of which the verdict is OK keeps its own triangles, unless `faces` is given.
    color : {"texture", "vertex"}, optional
        Default: colours of vertices for kept triangles of a model whose static colours are of vertices, else
        a texture.
    teacher : {"dedicated", "photographs"}
        What teaches: the look of the method, or the photographs of the scene.
    faces : int, optional
        The most fitted triangles, or about how many a surface has.
    texture : int, optional
        Texels along a side of the texture, 16 to 16384. Default: as many as pictures show.
    lods : sequence of float
        Levels of detail: falling shares of the faces, such as (0.5, 0.25, 0.1).
    collision : str, optional
        A shape to bump into: "mesh:N", "hulls:N" or "box" (`msb.bake.collision`).
    seconds : float
        About how long fitted triangles may take; a surface takes half as long again, and beside these twice
        as long, and each level of detail as long again. With 0 they move a single step; which are shown is
        chosen all the same. Collision is not counted.
    seed : int
        Where the search begins: the same gives the same on one device, if the time suffices.
    up : str, optional
        The axis, such as "+z", round which views are made where there are no cameras.
    background : (3,) floats, or str, optional
        As for `msb.render`; that of the scene, else the asset's own.
    device : str, optional
        The OpenCL device.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    keep_best : bool
        End with the best so far when interrupted (Ctrl-C); else nothing is made.
    cache : path-like, optional
        A folder in which the pictures that the model's own renderer draws are kept, and looked for first: a
        bake that was interrupted, or has other options, begins with those that are there.

    Returns
    -------
    Baked

    Raises
    ------
    UsageError
        An argument is none, or views that were made see less than 80 % of the asset's area.
    MetricError
        `METRIC_NOTHING_SHOWN`: no view sees the asset.
    Unsupported
        `UNSUPPORTED_TIER`: nothing draws the asset.
    AssetError, SceneError, DeviceError, InputError, CheckpointError, MeshFileError, MeshError
        As `msb.Renderer`, `msb.open` and `msb.scenes.read_scene` do.

    Examples
    --------
    >>> import msb
    >>> cameras = msb.read_cameras("data_stubs/views.json")
    >>> baked = msb.bake("data_stubs/checkpoint", cameras=cameras, geometry="kept")
    >>> baked.report.geometry, baked.asset.manifest.method
    ('kept', 'mesh')
    """
    options = Options(geometry, for_solid, color, teacher, faces, texture, seconds, seed)
    need_libraries("surface" if for_solid else geometry)
    wanted = checked_shares(lods) if lods else ()
    if collision is not None:
        kind_of(collision)
    place = None if cache is None else given_path(cache)
    if place is not None:
        check_place(place / SUFFIX)
    began = time.perf_counter()
    asset = as_asset(asset)
    options.check_model(asset, has_levels=bool(wanted))
    if collision is not None:
        triangles = asset.buffers["positions"], asset.buffers["indices"]
        need_for_shape(collision, triangles if geometry == "kept" else None)
    with about(asset.opened_from), room_for_temporaries(), _stopping(keep_best) as stopped:

        def watch(stage: str, done: int, total: int) -> bool:
            if progress is not None:
                progress(stage, done, total)
            return stopped()

        watch("views", 0, 1)
        views = bake_views(
            asset,
            scene,
            cameras,
            up=up,
            background=background,
            photographs=teacher == "photographs",
            device=device,
        )
        with Teacher(asset, views, teacher, device, place) as master:
            made = Bake(asset, views, master, options, device, watch, levels=bool(wanted))
            with closing(made):
                mesh, facts = made.best(stopped)
                watch("measuring", 0, 1)
                own, photographs = made.measured(mesh)
                levels, more = made.levels(facts.geometry, mesh, wanted)
                shape = None if collision is None else made.shape(mesh, collision)
            baked = asset_from_mesh(mesh)
            watch("preview", 0, 1)
            picture = preview(asset, baked, views, master, device)
            cached = [] if master.pictures is None else master.pictures.notes()
        watch("audit", 0, 1)
    worse = [WORSE] if own is not None and own.is_worse else []
    report = Report(
        geometry=facts.geometry,
        color="texture" if mesh.textures else "vertex",
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        texture=(mesh.textures[0].shape[1], mesh.textures[0].shape[0]) if mesh.textures else None,
        seconds=time.perf_counter() - began,
        taught=len(views.taught) - len(views.between),
        between=len(views.between),
        held_back=len(views.held_back),
        views=views.said,
        teacher=teacher,
        unseen_area=facts.unseen,
        own=own,
        photographs=photographs,
        before=Verdict.of(audit(asset)),
        after=Verdict.of(audit(baked)),
        model_faces=asset.manifest.face_count,
        background=views.background,
        seed=seed,
        device=choose_device(device).record.name,
        tried=facts.tried,
        notes=(*views.notes, *cached, *facts.notes, *worse, *more),
        lods=tuple(level for level, _ in levels),
        collision=None if shape is None else Shape.of(shape),
        path=None if asset.opened_from is None else str(asset.opened_from),
    )
    bumped = None if shape is None else asset_from_mesh(shape.mesh)
    return Baked(baked, report, picture, tuple(asset_from_mesh(one) for _, one in levels), bumped)


@contextmanager
def _stopping(keep_best: bool) -> Iterator[Callable[[], bool]]:
    """Yield what says whether to come to an end: after Ctrl-C, if that is to keep the best.

    A second one ends everything. Only the main thread hears of it.
    """
    heard: list[int] = []
    if not keep_best or threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = signal.getsignal(signal.SIGINT)

    def hear(number: int, _frame: object) -> None:
        heard.append(number)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, hear)
    try:
        yield lambda: bool(heard)
    finally:
        signal.signal(signal.SIGINT, before)
