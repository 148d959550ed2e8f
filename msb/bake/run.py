"""A bake from end to end: views, teacher, what is made of the faces, and what is measured of it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from msb.api.auditing import audit
from msb.api.opening import as_asset
from msb.asset.look import stored_threshold, visible_faces, written_up
from msb.asset.texture import MAX_SIDE
from msb.asset.tiers import why_not
from msb.bake.atlas import need_xatlas
from msb.bake.collision import PIXELS, kind_of
from msb.bake.collision import collision as collide
from msb.bake.fitted import PIXELS_TO_MOVE, fitted
from msb.bake.folder import only_folder, write_folder
from msb.bake.kept import FEWEST, PIXELS_TO_CHOOSE, kept
from msb.bake.lods import checked_shares, screen_share
from msb.bake.lods import lods as lods_of
from msb.bake.preview import Preview, preview
from msb.bake.report import Geometry, Level, Look, Psnr, Report, Shape, Verdict, compared, mean
from msb.bake.shares import blending_shares
from msb.bake.start import colored
from msb.bake.surface import surface
from msb.bake.teacher import SAMPLES, Source, Teacher
from msb.bake.texture import textured
from msb.bake.views import bake_views
from msb.bake.written import Part, write_all
from msb.base.atomic import room_for_temporaries
from msb.base.extras import need_extra
from msb.cl.devices import choose_device
from msb.errors import AssetError, UsageError, about, shorten
from msb.meshes.assets import asset_from_mesh
from msb.metrics import psnr
from msb.render import Renderer
from msb.topology.faces import face_areas

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.bake.collision import Collision
    from msb.bake.lessons import Lessons
    from msb.bake.shares import Shares
    from msb.bake.views import BakeViews
    from msb.meshes.mesh import Mesh
    from msb.scenes import Camera
    from msb.scenes.datasets import Scene

Wanted = Literal["auto", "kept", "fitted", "surface"]
Progress = Callable[[str, int, int], None]
LEAST_TEXTURE, MOST_TEXTURE = 16, MAX_SIDE
LEAST_SEEN = 0.8
"""Of the area of a model that nobody has cameras for, what made views must see."""
_SEARCH = 2 / 3
"""Of the time that a bake has, what a search has: that of the soup, and that of a surface's vertices."""
_NO_TIME = 1e-3
_TEXTURED = 2
"""How many times as large as the views the pictures are whose pixels a texture has texels for, and at least
those that teach."""


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
        parts = [Part("", self.asset, self.report.extras(), self.collision, is_convex)]
        parts += [Part(f"_lod{number}", one, {}) for number, one in enumerate(self.lods, 1)]
        parts += [] if self.collision is None else [Part("_collision", self.collision, {})]
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
        they lie beside the model, else 40 views round it or inside it.
    geometry : {"auto", "kept", "fitted", "surface"}
        The model's own triangles, triangles that were moved until the opaque picture is right, or one closed
        surface, which tools for solids can use. "auto" makes the first two, and takes what looks better in
        views that taught neither.
    for_solid : bool
        With "auto": make fitted triangles and a surface, and take the surface, unless its verdict is bad.
    color : {"texture", "vertex"}, optional
        Default: colours of vertices for kept triangles of a model with static colours, else a texture.
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
        About how long it may take; 0 leaves out the search.
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
    check_options(
        geometry=geometry,
        for_solid=for_solid,
        color=color,
        teacher=teacher,
        faces=faces,
        texture=texture,
        seconds=seconds,
        seed=seed,
    )
    need_libraries("surface" if for_solid else geometry)
    wish = _Wish(geometry, for_solid, color, faces, texture, seconds, seed)
    wanted = checked_shares(lods) if lods else ()
    if collision is not None:
        kind_of(collision)
    began = time.perf_counter()
    asset = as_asset(asset)
    wish.check_model(asset)
    with about(asset.opened_from), room_for_temporaries(), _stopping(keep_best) as stopped:
        views = bake_views(
            asset,
            scene,
            cameras,
            up=up,
            background=background,
            photographs=teacher == "photographs",
            device=device,
        )

        def watch(stage: str, done: int, total: int) -> bool:
            if progress is not None:
                progress(stage, done, total)
            return stopped()

        with Teacher(asset, views, teacher, device) as master:
            made = _Bake(asset, views, master, wish, device, watch)
            with closing(made):
                mesh, facts = made.best(stopped)
                own, photographs = made.measured(mesh)
                levels = made.levels(mesh, wanted)
                shape = None if collision is None else made.shape(mesh, collision)
            baked = asset_from_mesh(mesh)
            picture = preview(asset, baked, views, master, device)
    report = Report(
        geometry=facts.geometry,
        color="texture" if mesh.textures else "vertex",
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        texture=(mesh.textures[0].shape[1], mesh.textures[0].shape[0]) if mesh.textures else None,
        seconds=time.perf_counter() - began,
        taught=len(views.taught),
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
        notes=(*views.notes, *facts.notes),
        lods=tuple(level for level, _ in levels),
        collision=None
        if shape is None
        else Shape(
            shape.kind,
            len(shape.mesh.faces),
            shape.parts,
            shape.mean_distance,
            shape.mid_air_share,
            shape.why,
        ),
        path=None if asset.opened_from is None else str(asset.opened_from),
    )
    bumped = None if shape is None else asset_from_mesh(shape.mesh)
    return Baked(baked, report, picture, tuple(asset_from_mesh(one) for _, one in levels), bumped)


def check_options(
    *,
    geometry: str = "auto",
    for_solid: bool = False,
    color: str | None = None,
    teacher: str = "dedicated",
    faces: int | None = None,
    texture: int | None = None,
    seconds: float = 60.0,
    seed: int = 0,
) -> None:
    """Refuse options of `bake` that are none or do not go together, before anything is read."""
    for name, value, words in (
        ("geometry", geometry, get_args(Wanted)),
        ("color", color, (None, *get_args(Look))),
        ("teacher", teacher, get_args(Source)),
    ):
        if value not in words:
            one_of = ", ".join(word for word in words if word)
            raise UsageError("USAGE", f'{name} is "{shorten(str(value), 40)}"; it must be one of {one_of}')
    if for_solid and geometry != "auto":
        text = f'for_solid chooses among what geometry "auto" makes; "{geometry}" is chosen already'
        raise UsageError("USAGE", text)
    if texture is not None:
        if not LEAST_TEXTURE <= texture <= MOST_TEXTURE:
            text = f"texture is {texture}; it must be {LEAST_TEXTURE} to {MOST_TEXTURE} texels a side"
            raise UsageError("USAGE", text)
        if color == "vertex":
            raise UsageError("USAGE", "texture is the size of a texture, which color vertex has none of")
    if faces is not None and faces < 1:
        raise UsageError("USAGE", f"faces is {faces}; it must be 1 or more")
    if faces is not None and geometry == "kept":
        raise UsageError("USAGE", "faces limits fitted ones; kept ones are the model's own")
    if not 0 <= seconds < float("inf"):
        raise UsageError("USAGE", f"seconds is {seconds}; it must be 0 or more")
    if seed < 0:
        raise UsageError("USAGE", f"seed is {seed}; it must be 0 or more")


def need_libraries(geometry: str) -> None:
    """Refuse a geometry whose libraries are not installed."""
    if geometry == "surface":
        need_extra("bench", "skimage", what="a closed surface")
        need_extra("trial", "fast_simplification", "xatlas", what="a closed surface")


@dataclass(frozen=True)
class _Wish:
    """What is asked for of the faces and their colours."""

    geometry: Wanted
    for_solid: bool
    color: Look | None
    faces: int | None
    texture: int | None
    seconds: float
    seed: int

    def look(self, name: Geometry, asset: Asset) -> Look:
        """Return where the colours of a geometry go."""
        # What has no static colours has its look within each face, which colours of corners do not show.
        has_colors = why_not(asset.manifest, "standard") is None
        usual: Look = "vertex" if name == "kept" and has_colors and self.texture is None else "texture"
        return self.color or usual

    def check_model(self, asset: Asset) -> None:
        """Refuse what would be found to be missing when most of the work is done."""
        is_auto = self.geometry == "auto" and self.faces is None and not self.for_solid
        is_soup = asset.manifest.vertex_count == 3 * asset.manifest.face_count
        if (is_auto or self.geometry == "kept") and not is_soup and self.look("kept", asset) == "texture":
            need_xatlas()


@dataclass(frozen=True)
class _Facts:
    """What was found out while the mesh was made."""

    geometry: Geometry
    unseen: float
    tried: dict[str, float]
    notes: tuple[str, ...]


class _Bake:
    """One bake: what teaches, what is made, and what that looks like."""

    def __init__(
        self,
        asset: Asset,
        views: BakeViews,
        master: Teacher,
        wish: _Wish,
        device: str | None,
        watch: Callable[[str, int, int], bool],
    ) -> None:
        self._asset, self._views, self._master, self._wish = asset, views, master, wish
        self._device, self._watch = device, watch
        self._pixels = max(camera.width * camera.height for camera in views.taught)
        is_small = (2 * _TEXTURED) ** 2 * self._pixels <= PIXELS_TO_MOVE
        scale = 2 * _TEXTURED if is_small else _TEXTURED  # the larger, the finer are borders of faces found
        self._taught = master.lessons(views.taught, scale)
        first = range(len(views.teaching))
        self._teaching = self._taught.part(first)
        self._aside = self._taught.part(range(len(first), len(views.taught)) or first)
        self._soups: dict[int | None, tuple[Mesh, list[str]]] = {}

    def close(self) -> None:
        """Give the pictures back."""
        for lessons in (self._teaching, self._aside, self._taught):
            lessons.close()

    def best(self, stopped: Callable[[], bool]) -> tuple[Mesh, _Facts]:
        """Return the mesh as it is written, and what was found out."""
        for number in range(len(self._taught)):
            self._taught.stored(number)
            self._watch("looking at the model", number + 1, len(self._taught))
        unseen, shares = self._seen()
        wanted, notes = self._wanted()
        made: dict[Geometry, Mesh] = {}
        said: dict[Geometry, list[str]] = {}
        for name in wanted:
            if made and stopped():
                break
            try:
                made[name], said[name] = self._made(name, shares)
            except AssetError as error:
                if not made:
                    raise
                notes.append(f"there is no {name}: {error.message}")
        tried: dict[str, float] = {}
        if len(made) > 1:  # in colours that what is aside did not teach
            truths = [self._aside.within(self._pixels)]
            for name in reversed(made):  # what is made last, of the others, is the first to be told of
                judged = self._colored(made[name], self._wish.look(name, self._asset), self._teaching)
                tried[name] = self._psnr(asset_from_mesh(judged), truths, SAMPLES)[0]
        chosen, why = self._chosen(made, tried)
        notes += said[chosen]
        if stopped():
            notes.append("interrupted: this is the best so far")
        mesh = self._colored(made[chosen], self._wish.look(chosen, self._asset), self._taught)
        if why:
            notes.append(f"{why}: {compared(tried)}")
        if dropped := self._asset.manifest.face_count - len(mesh.faces):
            verb = "fewer" if dropped > 0 else "more"
            notes.append(f"{abs(dropped):,} triangles {verb} than the model's")
        return mesh, _Facts(chosen, unseen, tried, tuple(notes))

    def _chosen(self, made: dict[Geometry, Mesh], tried: dict[str, float]) -> tuple[Geometry, str]:
        """Return which of what is made is taken, and why, if there was a choice."""
        best = max(made, key=lambda name: tried.get(name, 0.0))
        if not tried:
            return best, ""
        if "surface" not in made:
            return best, "the better of two"
        verdict = Verdict.of(audit(asset_from_mesh(made["surface"])))
        if verdict.level == "bad":
            return "fitted", f"the surface is not taken, as its verdict is BAD: {verdict.reason}"
        return "surface", "the surface is taken, which tools for solids need"

    def _seen(self) -> tuple[float, Shares | None]:
        """Return the share of the area that no view sees, and what faces add to the pictures that teach.

        Views that were made must see most of it.
        """
        teaching, aside = (
            blending_shares(self._asset, lessons.within(PIXELS_TO_CHOOSE), self._device)
            for lessons in (self._teaching, self._aside)
        )
        if teaching is None or aside is None:
            return 0.0, None
        buffers = self._asset.buffers
        area = face_areas(buffers["positions"], buffers["indices"])[0]
        shown = visible_faces(self._asset, stored_threshold(self._asset))
        if shown is not None:
            area[~shown] = 0.0
        unseen = float(area[teaching.weight + aside.weight == 0].sum() / max(area.sum(), 1e-300))
        views = self._views
        if views.origin in ("turntable", "inside") and 1 - unseen < LEAST_SEEN:
            text = f"{views.said} see {int(100 * (1 - unseen))} % of its area, and 80 % are needed"
            raise UsageError("USAGE", f"{text}: give its scene (--scene) or cameras (--cameras)")
        return unseen, None if why_not(self._asset.manifest, "dedicated") else teaching

    def _wanted(self) -> tuple[list[Geometry], list[str]]:
        """Return the geometries to make, and what is to be said of one that is left out."""
        wish, count = self._wish, self._asset.manifest.face_count
        if wish.geometry != "auto":
            return [wish.geometry], []
        if wish.for_solid:
            return ["fitted", "surface"], []
        if wish.faces is not None:
            return ["fitted"], []
        if count * FEWEST > min(self._taught.largest, PIXELS_TO_MOVE):
            return ["kept"], [f"fitted is not tried with {count:,} faces, which pictures are too small for"]
        return ["kept", "fitted"], []

    def _made(self, name: Geometry, shares: Shares | None) -> tuple[Mesh, list[str]]:
        """Return the mesh of a geometry, in rough colours, and what should be known of it."""
        wish = self._wish
        shared: dict[str, Any] = {"seed": wish.seed, "device": self._device, "watch": self._watch}
        lessons = self._asset, self._teaching, self._aside, shares
        seconds = max(_SEARCH * wish.seconds, _NO_TIME)
        notes: list[str] = []
        if name == "kept":
            mesh = kept(*lessons, **shared)
        else:
            # A surface has its number of faces from the end, not from the soup that it is made of.
            most = wish.faces if name == "fitted" else None
            if most not in self._soups:
                self._soups[most] = fitted(*lessons, seconds=seconds, faces=most, **shared)
            mesh, notes = self._soups[most]
        if name == "surface":
            shared["seconds"] = seconds
            mesh, more = surface(mesh, self._teaching, self._aside, faces=wish.faces, **shared)
            notes = [f"of the soup it is made of: {note}" for note in notes] + more
        return mesh, notes

    def levels(self, mesh: Mesh, shares: Sequence[float]) -> list[tuple[Level, Mesh]]:
        """Return the levels of detail of what was made, with a texture as large as its own."""
        if not shares:
            return []
        size = mesh.textures[0].shape[0] if mesh.textures else None
        bare = replace(mesh, corner_uvs=None, textures=())
        lessons = self._teaching, self._aside
        made = lods_of(bare, *lessons, shares, seed=self._wish.seed, device=self._device, watch=self._watch)
        found = []
        for share, one in zip(shares, made, strict=True):
            level = self._colored(one, "vertex" if size is None else "texture", self._taught, size)
            own = self.measured(level)[0]
            facts = len(level.faces), None if own is None else own.after_16, screen_share(mesh, level)
            found.append((Level(share, *facts), level))
        return found

    def shape(self, mesh: Mesh, kind: str) -> Collision:
        """Return what stands in for what was made where things bump into it."""
        self._watch("collision", 0, 1)
        cameras = self._taught.within(PIXELS).cameras
        return collide(mesh, kind, cameras, device=self._device)

    def _colored(self, mesh: Mesh, look: Look, lessons: Lessons, size: int | None = None) -> Mesh:
        """Return a mesh as it is written, in the colours that fit lessons best: in bytes at its vertices, or
        in a texture of this size, or of the one that was asked for."""
        shown = lessons.within(_TEXTURED**2 * self._pixels).cameras
        lessons = lessons.with_halves(self._pixels)
        mesh = colored(mesh, lessons, self._device)
        if look == "texture":
            size = size or self._wish.texture
            mesh = textured(mesh, lessons, size, shown=shown, device=self._device, watch=self._watch)
        else:
            assert mesh.vertex_colors is not None
            colors = np.floor(mesh.vertex_colors.clip(0, 1) * 255 + np.float32(0.5))
            mesh = replace(mesh, vertex_colors=colors.astype(np.uint8))
        return replace(mesh, up=written_up(self._asset))

    def measured(self, mesh: Mesh) -> tuple[Psnr | None, Psnr | None]:
        """Return the numbers of the views held back: against the own look, and against photographs."""
        held_back, master, made = self._views.held_back, self._master, asset_from_mesh(mesh)
        if not held_back:
            return None, None
        with ExitStack() as stack:
            truths = [stack.enter_context(master.looks(held_back))]
            if self._views.scene is not None:
                truths.append(stack.enter_context(master.photographs(held_back)))
            before: list[Any] = [None, None]
            if why_not(self._asset.manifest, "standard") is None:
                before = self._psnr(self._asset, truths, 1)
            after, after_16 = self._psnr(made, truths, 1), self._psnr(made, truths, SAMPLES)
            own = Psnr(None, before[0], after[0], after_16[0])
            if len(truths) == 1:
                return own, None
            looks, photographs = truths
            dedicated = [psnr(looks.image(k), photographs.image(k)) for k in range(len(held_back))]
            return own, Psnr(mean(dedicated), before[1], after[1], after_16[1])

    def _psnr(self, asset: Asset, truths: Sequence[Lessons], samples: int) -> list[float]:
        """Return the mean dB of the standard tier to each of the truths, which are of the same cameras."""
        found: list[list[float]] = [[] for _ in truths]
        with Renderer(asset, "standard", self._device, supersample=samples) as renderer:
            for number, camera in enumerate(truths[0].cameras):
                image = renderer.render(camera, self._views.background).image
                for values, truth in zip(found, truths, strict=True):
                    values.append(psnr(image, truth.image(number)))
        return [mean(values) for values in found]


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
