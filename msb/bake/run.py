"""A complete bake: options, views, images, meshes, quality and report."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

import numpy as np

from msb.api.auditing import audit
from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.frame import with_frame
from msb.asset.origin import with_origin, without_origin
from msb.bake.folder import is_folder_output, write_folder
from msb.bake.image_cache import SUFFIX
from msb.bake.options import BakeKeywords, BakeOptions, Material, need_libraries
from msb.bake.outer_skin import add_outer_skin, is_interior
from msb.bake.output_files import OutputAsset, list_endings, write_assets
from msb.bake.placing import choose_frame, move_frame
from msb.bake.preview import Preview, make_preview
from msb.bake.report import (
    CollisionReport,
    Report,
    ShapeReport,
    Verdict,
    list_coverage_notes,
    list_quality_notes,
)
from msb.bake.requirements import check_model
from msb.bake.shape import compare_with_truth, measure_visible_bending
from msb.bake.supervision import BakeInputs, make_best_attempt
from msb.bake.views import BakeViews
from msb.base.atomic import check_place, room_for_temporaries
from msb.base.origin import NO_ORIGIN, Origin
from msb.base.paths import given_path
from msb.base.soup import is_soup
from msb.cl.devices import choose_device
from msb.errors import about
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.scenes import Camera
from msb.scenes.datasets import Scene

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False, repr=False)
class Baked:
    """A baked asset with its levels of detail, its collision shape, and the report on its quality.

    Attributes
    ----------
    asset : Asset
        An asset of method "mesh" in memory, with a texture or vertex colours.
    report : Report
        `sentence` is the result in one line, and `to_dict` returns the data of `msb bake --json`.
    preview : Preview
        Images of the target, of the unbaked mesh and of the baked mesh side by side.
    lods : tuple of Asset
        The levels of detail, the finest first.
    collision : Asset or None
        The collision shape, without colours.
    material : {"unlit", "lit"}
        Whether programs that open a written GLB, OBJ or USD file light its materials.
    """

    asset: Asset
    report: Report
    preview: Preview
    lods: tuple[Asset, ...] = ()
    collision: Asset | None = None
    material: Material = "unlit"

    def save(self, *paths: str | os.PathLike[str], overwrite: bool = False) -> Report:
        """Write the asset to all paths or to none. Return the report with the files at the first path.

        The suffix of a path names its format. A GLB has the report's main numbers in its `asset.extras`.
        Levels of detail and the collision shape are written next to each path: NAME_lod1, NAME_lod2, ...,
        NAME_collision.

        An output folder must be the only path. A path is a folder if it has no suffix, or if a folder with
        this name exists. An output folder gets asset.glb and its companions, bake.json, preview.png and the
        page index.html. In an existing folder, only files written by an earlier bake are replaced.
        """
        is_convex = self.report.collision is not None and self.report.collision.kind != "mesh"
        companions = self.lods if self.collision is None else (*self.lods, self.collision)
        main, *endings = list_endings(len(self.lods), has_collision=self.collision is not None)
        is_lit = self.material == "lit"
        assets = [OutputAsset(main, self.asset, self.report.extras(), self.collision, is_convex, is_lit)]
        assets += [
            OutputAsset(end, asset, {}, is_lit=is_lit) for end, asset in zip(endings, companions, strict=True)
        ]
        places = [Path(path) for path in paths]
        if is_folder_output(places):
            return write_folder(self, assets, places[0], overwrite)
        return self.report.with_files(write_assets(assets, places, overwrite))

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
        The model, or any path that `msb.open` accepts. The asset is not changed.
    scene : Scene or path-like, optional
        The scene that the model was trained on. The training views of the scene supervise. The test views are
        only used for the report.
    cameras : iterable of Camera, optional
        Views to use instead of a scene. Every 8th view is held out for the report. The default is the
        training cameras if their file lies beside the model, else 40 generated views around the model or
        inside it. If there are fewer than 40 supervising views, interpolated views are added.
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
        "kept": the model's own triangles. "fitted": triangles moved until the opaque image matches.
        "surface": one closed surface for tools that need a solid. "auto" makes kept triangles and fitted
        triangles, and chooses the better result on the validation views.
    for_solid : bool, default False
        With "auto": make fitted triangles and a surface, and choose the surface unless its verdict is bad. A
        mesh file with the verdict OK keeps its triangles, unless `faces` is given.
    color : {"texture", "vertex"}, optional
        Default: vertex colours for kept triangles of a model with static vertex colours, else a texture.
    supervision : {"native", "photographs"}, optional
        The training images: the method's native renderings, or the photographs of the scene. The default is
        "native". With the geometry "auto", both kinds of images are tried if `scene` has photographs.
        Photographs are chosen if they gain 0.5 dB on the photographs of the validation views. With
        photographs, the result no longer reproduces the native rendering.
    faces : int, optional
        The largest number of fitted triangles, or the approximate number of triangles of a surface.
    texture : int, optional
        Texels along a side of the texture, 16 to 16384. The default is about one texel per pixel that shows
        the mesh in the images.
    material : {"unlit", "lit"}, default "unlit"
        Whether programs show the colours as stored, or apply lighting. Baked colours contain the light of the
        photographs with both materials.
    lods : sequence of float, or str, optional
        Levels of detail: falling shares of the faces, such as (0.5, 0.25, 0.1) or "0.5,0.25,0.1".
    collision : str, optional
        A collision shape: "mesh:N", "hulls:N" or "box" (`msb.bake.collision`).
    thickness : float, default 0.05
        The surface of an interior gets an outer skin, which makes it a solid of positive volume. In each
        direction, the walls have this thickness, as a share of the distance from the middle.
    effort : {"draft", "normal", "fine"}, default "normal"
        The number of steps of each search: a quarter of the normal number, the normal number, or 2.5 times
        as many. The result does not depend on the speed or the load of the machine.
    seconds : float, optional
        Upper limit of the time to move fitted triangles. By default, there is no limit. A surface takes about
        1.5 times `seconds` in total. Fitted triangles and a surface together take about 2 times `seconds`.
        Each level of detail adds `seconds` to the total time. A note reports the number of skipped steps. The
        result then depends on the speed of the machine. If `seconds` is 0, triangles move by a single step,
        and the face selection still runs. The time for `collision` is not included.
    seed : int, default 0
        Seed of the search. Without a limit of `seconds`, bakes with one seed on one device have the same
        result.
    truth : path-like, optional
        A mesh of the true surface, in the coordinates of the model. With `truth`, the report contains the
        differences of normals and depths from the true surface (`msb.bake.shape`).
    up : str, optional
        The up direction for generated views and in mesh files: an axis such as "+z", or "X,Y,Z". Default: the
        up direction of the asset, else an estimate from the cameras of the scene.
    scale : float, optional
        The length of the scene's unit in metres. With `scale`, mesh files are written in metres.
    known_distance : (str, str, str), optional
        In place of `scale`: two points "X,Y,Z" of the scene and their distance, such as "1.2m".
    floor : bool, default False
        Put the lowest visible point at height 0 in mesh files.
    views : {"outside", "inside", "both"}, optional
        Generate views around the asset, inside it, or both, even if training cameras lie beside it. Default:
        training cameras, else the generated views that show more of the area.
    keep_best : bool, default False
        After an interrupt (Ctrl-C), return the best result instead of raising.
    cache : path-like, optional
        A folder of native renderings. Renderings are written to this folder and reused by later bakes.

    Raises
    ------
    UsageError
        An argument is invalid, or views from inside are requested for a flat asset.
    MetricError
        `METRIC_NOTHING_SHOWN`: no view sees the asset.
    Unsupported
        `UNSUPPORTED_TIER`: neither the dedicated tier nor the standard tier can draw the asset.
    AssetError, SceneError, DeviceError, InputError, CheckpointError, MeshFileError, MeshError
        Errors of `msb.Renderer`, `msb.open` and `msb.scenes.read_scene`.

    Examples
    --------
    >>> import msb
    >>> cameras = msb.read_cameras("data_stubs/views.json")
    >>> baked = msb.bake("data_stubs/checkpoint", cameras=cameras, geometry="kept")
    >>> baked.report.geometry, baked.asset.manifest.method
    ('kept', 'mesh')
    """
    settings = BakeOptions(**options)
    need_libraries(settings)
    cache = None if settings.cache is None else given_path(settings.cache)
    if cache is not None:
        check_place(cache / SUFFIX)
    began = time.perf_counter()
    model = as_asset(asset)
    check_model(settings, model)
    with about(model.opened_from), room_for_temporaries(), _catch_interrupt(settings.keep_best) as stopped:

        def report_progress(stage: str, done: int, total: int) -> bool:
            if progress is not None:
                progress(stage, done, total)
            return stopped()

        with ExitStack() as stack:
            inputs = BakeInputs(model, scene, cameras, background, device, cache, report_progress)
            attempt, supervisions, supervision_notes = make_best_attempt(inputs, settings, stack, stopped)
            views, source, pipeline = attempt.views, attempt.source, attempt.pipeline
            mesh, choice = attempt.mesh, attempt.choice
            # All stages compute in float32 and use coordinates relative to the origin of the model.
            origin = model.manifest.origin
            model = without_origin(model)
            report_progress("measuring", 0, 1)
            native, photographs = pipeline.measure(mesh)
            shape_report = _measure_shape(mesh, views, settings, origin, device)
            levels, level_notes = pipeline.make_levels(choice.geometry, mesh, settings.lod_shares)
            kind = settings.collision
            collision = None if kind is None else pipeline.make_collision(mesh, kind)
            if choice.geometry == "surface" and is_interior(mesh):
                mesh = add_outer_skin(mesh, settings.thickness)
                levels = [(level, add_outer_skin(lod, settings.thickness)) for level, lod in levels]
            baked = asset_from_mesh(mesh, origin=NO_ORIGIN)
            frame = choose_frame(model, baked, views, settings, device)
            report_progress("preview", 0, 1)
            preview = make_preview(model, baked, views, source, device)
            cache_notes = [] if source.cache is None else source.cache.notes()
        report_progress("audit", 0, 1)
    quality_notes = list_quality_notes(source.supervision, native, photographs)
    quality_notes += list_coverage_notes(views, choice.unseen_area)
    report = Report(
        geometry=choice.geometry,
        color="texture" if mesh.textures else "vertex",
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        texture=(mesh.textures[0].shape[1], mesh.textures[0].shape[0]) if mesh.textures else None,
        seconds=time.perf_counter() - began,
        training=len(views.training),
        validation=len(views.validation),
        test=len(views.test),
        interpolated=len(views.interpolated),
        views=views.description,
        supervision=source.supervision,
        supervisions=supervisions,
        unseen_area=choice.unseen_area,
        native=native,
        photographs=photographs,
        shape=shape_report,
        before=None if model.manifest.primitive == "gaussian" else Verdict.of(audit(model)),
        after=Verdict.of(audit(baked)),
        model_faces=model.manifest.face_count,
        background=views.background,
        seed=settings.seed,
        device=choose_device(device).record.name,
        tried=choice.tried,
        notes=(*views.notes, *cache_notes, *supervision_notes, *choice.notes, *quality_notes, *level_notes),
        lods=tuple(level for level, _ in levels),
        collision=None if collision is None else CollisionReport.of(collision),
        path=None if model.opened_from is None else str(model.opened_from),
    )
    # Move the results back into scene coordinates, and add the known frame of the scene.
    frame = move_frame(frame, origin)

    def in_scene(asset: Asset) -> Asset:
        return with_frame(with_origin(asset, origin), frame)

    lods = tuple(in_scene(asset_from_mesh(lod, origin=NO_ORIGIN)) for _, lod in levels)
    shape = None if collision is None else in_scene(asset_from_mesh(collision.mesh, origin=NO_ORIGIN))
    moved = preview.moved_back(origin)
    return Baked(in_scene(baked), report, moved, lods, shape, settings.material)


def _measure_shape(
    mesh: Mesh, views: BakeViews, settings: BakeOptions, origin: Origin, device: str | None
) -> ShapeReport | None:
    """Return the shape of a connected mesh in the test views. Without test views, use all views.

    The mesh and the views are relative to `origin`.
    """
    if is_soup(mesh.faces):
        return None
    cameras = views.test or views.all_but_test
    bending = measure_visible_bending(mesh, cameras, device)
    if settings.truth is None:
        return ShapeReport(bending)
    truth = mesh_from_asset(as_asset(settings.truth))
    truth = replace(truth, vertices=(truth.vertices - np.array(origin)).astype(np.float32))
    return ShapeReport(bending, compare_with_truth(mesh, truth, cameras, device))


@contextmanager
def _catch_interrupt(keep_best: bool) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the search should stop.

    If `keep_best` is true, the function returns true after the first Ctrl-C. A second Ctrl-C interrupts the
    program as usual. Outside the main thread, the function always returns false, because only the main thread
    receives signals.
    """
    received: list[int] = []
    if not keep_best or threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = signal.getsignal(signal.SIGINT)

    def receive(number: int, _frame: object) -> None:
        received.append(number)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, receive)
    try:
        yield lambda: bool(received)
    finally:
        signal.signal(signal.SIGINT, before)
