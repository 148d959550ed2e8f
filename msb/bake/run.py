"""A bake from end to end: options, views, training images, meshes, measurements and report."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

from msb.api.auditing import audit
from msb.api.opening import as_asset
from msb.asset import Asset
from msb.bake.cache import SUFFIX
from msb.bake.folder import only_folder, write_folder
from msb.bake.making import Bake
from msb.bake.needs import check_model
from msb.bake.options import BakeKeywords, BakeOptions, need_libraries
from msb.bake.preview import Preview, preview
from msb.bake.report import WORSE, Report, Shape, Verdict
from msb.bake.teacher import Teacher
from msb.bake.views import bake_views
from msb.bake.written import Part, endings, write_all
from msb.base.atomic import check_place, room_for_temporaries
from msb.base.paths import given_path
from msb.cl.devices import choose_device
from msb.errors import about
from msb.meshes.assets import asset_from_mesh
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
    background: Sequence[float] | str | None = None,
    device: str | None = None,
    progress: Progress | None = None,
    **options: Unpack[BakeKeywords],
) -> Baked:
    """Make an opaque mesh, with a texture or vertex colours, that looks like the native rendering of a model.

    Parameters
    ----------
    asset : Asset or path-like
        The model, or the path of anything that `msb.open` takes. It is not changed.
    scene : Scene or path-like, optional
        The scene the model was trained on. Its training views supervise; its test views are only used for
        the report.
    cameras : iterable of Camera, optional
        Views instead of a scene's; every 8th is held out for the report. Default: the training cameras, if
        they lie beside the model, else 40 generated views around it or inside it. Fewer than 40 supervising
        views are completed by interpolated views.
    background : (3,) floats, or str, optional
        As for `msb.render`. Default: the scene's background, else the asset's.
    device : str, optional
        The OpenCL device.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    **options
        The fields of `msb.bake.options.BakeOptions`, which "Other Parameters" describes.

    Returns
    -------
    Baked

    Other Parameters
    ----------------
    geometry : {"auto", "kept", "fitted", "surface"}, default "auto"
        The model's own triangles, triangles moved until the opaque image is right, or one closed surface for
        tools that need a solid. "auto" makes the first two and takes the better by its validation views.
    for_solid : bool, default False
        With "auto": make fitted triangles and a surface, and take the surface unless its verdict is bad. A
        plain mesh with the verdict OK keeps its triangles, unless `faces` is given.
    color : {"texture", "vertex"}, optional
        Default: vertex colours for kept triangles of a model with static vertex colours, else a texture.
    teacher : {"dedicated", "photographs"}, default "dedicated"
        The training images: the method's native renderings, or the photographs of the scene.
    faces : int, optional
        The largest number of fitted triangles, or the approximate number of a surface.
    texture : int, optional
        Texels along a side of the texture, 16 to 16384. Default: as many as the images resolve.
    lods : sequence of float, or str, optional
        Levels of detail: falling shares of the faces, such as (0.5, 0.25, 0.1) or "0.5,0.25,0.1".
    collision : str, optional
        A collision shape: "mesh:N", "hulls:N" or "box" (`msb.bake.collision`).
    seconds : float, default 60
        Approximate time to move fitted triangles. A surface takes half as long again, both together twice
        as long, and each level of detail as long again. With 0 they move a single step, and the face
        selection still runs. The time for `collision` is not included.
    seed : int, default 0
        Seed of the search. One seed gives one result on one device, if the time suffices.
    up : str, optional
        The axis, such as "+z", around which views are generated if there are no cameras.
    keep_best : bool, default False
        Return the best result so far after an interrupt (Ctrl-C) instead of raising.
    cache : path-like, optional
        A folder of native renderings. They are written there and reused by later bakes.

    Raises
    ------
    UsageError
        An argument is invalid, or the generated views see less than 80 % of the asset's area.
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
    wanted = BakeOptions(**options)
    need_libraries(wanted)
    cache = None if wanted.cache is None else given_path(wanted.cache)
    if cache is not None:
        check_place(cache / SUFFIX)
    began = time.perf_counter()
    model = as_asset(asset)
    check_model(wanted, model)
    with about(model.opened_from), room_for_temporaries(), _stopping(wanted.keep_best) as stopped:

        def watch(stage: str, done: int, total: int) -> bool:
            if progress is not None:
                progress(stage, done, total)
            return stopped()

        watch("views", 0, 1)
        views = bake_views(
            model,
            scene,
            cameras,
            up=wanted.up,
            background=background,
            photographs=wanted.teacher == "photographs",
            device=device,
        )
        with Teacher(model, views, wanted.teacher, device, cache) as teacher:
            with closing(Bake(model, views, teacher, wanted, device, watch)) as bake:
                mesh, facts = bake.best(stopped)
                watch("measuring", 0, 1)
                own, photographs = bake.measure(mesh)
                levels, level_notes = bake.levels(facts.geometry, mesh, wanted.shares)
                shape = None if wanted.collision is None else bake.shape(mesh, wanted.collision)
            baked = asset_from_mesh(mesh)
            watch("preview", 0, 1)
            picture = preview(model, baked, views, teacher, device)
            cached = [] if teacher.pictures is None else teacher.pictures.notes()
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
        teacher=wanted.teacher,
        unseen_area=facts.unseen,
        own=own,
        photographs=photographs,
        before=Verdict.of(audit(model)),
        after=Verdict.of(audit(baked)),
        model_faces=model.manifest.face_count,
        background=views.background,
        seed=wanted.seed,
        device=choose_device(device).record.name,
        tried=facts.tried,
        notes=(*views.notes, *cached, *facts.notes, *worse, *level_notes),
        lods=tuple(level for level, _ in levels),
        collision=None if shape is None else Shape.of(shape),
        path=None if model.opened_from is None else str(model.opened_from),
    )
    assets = tuple(asset_from_mesh(mesh) for _, mesh in levels)
    return Baked(baked, report, picture, assets, None if shape is None else asset_from_mesh(shape.mesh))


@contextmanager
def _stopping(keep_best: bool) -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether to stop: True after the first Ctrl-C, if the best is to be kept.

    A second Ctrl-C interrupts as usual. Signals only reach the main thread.
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
