"""One bake: what is made of the faces of a model, which of that is taken, and in which colours."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from msb.api.auditing import audit
from msb.asset import Asset
from msb.asset.look import stored_threshold, visible_faces, written_up
from msb.asset.tiers import why_not
from msb.bake.collision import PIXELS, Collision
from msb.bake.collision import collision as collide
from msb.bake.fitted import PIXELS_TO_MOVE, fitted
from msb.bake.kept import FEWEST, FINE, choosing, kept, rejoined
from msb.bake.lessons import Lessons
from msb.bake.lods import lods, screen_share
from msb.bake.measured import mean_psnr, measured
from msb.bake.needs import choose_look
from msb.bake.options import BakeOptions, Geometry, Look
from msb.bake.report import Level, Psnr, Verdict, compared
from msb.bake.shares import Shares, blending_shares
from msb.bake.start import Guide, Watch, colored
from msb.bake.surface import surface
from msb.bake.teacher import SAMPLES, Teacher
from msb.bake.texture import few_of, textured
from msb.bake.views import BakeViews
from msb.errors import AssetError, UsageError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.topology.faces import face_areas

LEAST_SEEN = 0.8  # least share of the area that generated views must see
# Shares of `seconds`: for fitted triangles and for each level of detail; for each of a surface's two
# searches, of the soup that its depth maps show and of its vertices.
_SEARCH, _SURFACE = 2 / 3, 0.4
_NO_TIME = 1e-3
_FOR_SOLID: tuple[Geometry, ...] = ("fitted", "surface")
_OPAQUE = "its triangles are opaque: where alpha cut them off they have the colour of what lies behind"
_TEXTURED = 2  # scale of the training images relative to the views whose pixels a texture resolves


def _is_solid(asset: Asset) -> bool:
    return Verdict.of(audit(asset)).level == "ok"


@dataclass(frozen=True)
class Facts:
    """What was found out while the mesh was made."""

    geometry: Geometry
    unseen: float
    tried: dict[str, float]
    notes: tuple[str, ...]


class Bake:
    """One bake: what teaches, what is made, and what that looks like."""

    def __init__(
        self,
        asset: Asset,
        views: BakeViews,
        master: Teacher,
        options: BakeOptions,
        device: str | None,
        watch: Watch,
    ) -> None:
        self._asset, self._views, self._master, self._options = asset, views, master, options
        self._device, self._watch = device, watch
        self._pixels = max(camera.width * camera.height for camera in views.taught)
        self._taught = master.lessons(views.taught, self._scale())
        first = range(len(views.taught) - len(views.aside))
        self._teaching = self._taught.part(first)
        self._aside = self._taught.part(range(len(first), len(views.taught)) or first)
        is_plain = why_not(asset.manifest, "dedicated") is not None and options.teacher == "dedicated"
        self._guide = Guide(self._teaching, self._aside, options.seed, device, watch, is_plain)
        self._soups: dict[int | None, tuple[Mesh, list[str]]] = {}
        self._rough: Mesh | None = None

    def _scale(self) -> int:
        """Return how many times as large as the views the pictures are that teach.

        The larger they are, the finer borders of faces are found. Where nothing moves, without a texture,
        pixels of the views are as good if faces have some, and the model is drawn in a quarter of the time.
        """
        if (2 * _TEXTURED) ** 2 * self._pixels <= PIXELS_TO_MOVE:
            return 2 * _TEXTURED
        options = self._options
        is_kept = options.geometry == "kept" and choose_look(options, "kept", self._asset) == "vertex"
        has_pixels = self._pixels >= FINE * self._asset.manifest.face_count
        return 1 if is_kept and has_pixels and not options.shares else _TEXTURED

    def close(self) -> None:
        """Give the pictures back."""
        for lessons in (self._teaching, self._aside, self._taught):
            lessons.close()

    def best(self, stopped: Callable[[], bool]) -> tuple[Mesh, Facts]:
        """Return the mesh as it is written, and what was found out."""
        self._watch("looking at the model", 0, len(self._taught))
        for number in range(len(self._taught)):
            self._taught.stored(number)
            self._watch("looking at the model", number + 1, len(self._taught))
        self._master.rest()
        unseen, shares = self._seen()
        wanted, notes = self._wanted()
        mesh, facts = self._taken(wanted, notes, unseen, shares, stopped)
        if self._options.for_solid and facts.geometry == "kept" and not _is_solid(asset_from_mesh(mesh)):
            return self._taken(_FOR_SOLID, [], unseen, shares, stopped)
        return mesh, facts

    def _taken(
        self,
        wanted: Sequence[Geometry],
        notes: list[str],
        unseen: float,
        shares: Shares | None,
        stopped: Callable[[], bool],
    ) -> tuple[Mesh, Facts]:
        """Return that of the `wanted` geometries which is taken, as it is written, and what was found out."""
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
                judged = self._colored(name, made[name], self._look(name, made[name]), self._teaching)
                self._watch("comparing", 0, 1)
                tried[name] = mean_psnr(asset_from_mesh(judged), truths, SAMPLES, self._device)[0]
        chosen, why = self._chosen(made, tried)
        notes += said[chosen]
        if self._options.shares:  # a texture takes the place of its colours, which levels begin with
            self._rough = made[chosen]
        if stopped():
            notes.append("interrupted: this is the best so far")
        mesh = self._colored(chosen, made[chosen], self._look(chosen, made[chosen]), self._taught)
        if why:
            notes.append(f"{why}: {compared(tried)}")
        if dropped := self._asset.manifest.face_count - len(mesh.faces):
            verb = "fewer" if dropped > 0 else "more"
            plural = "s" if abs(dropped) > 1 else ""
            notes.append(f"{abs(dropped):,} triangle{plural} {verb} than the model's")
        return mesh, Facts(chosen, unseen, tried, tuple(notes))

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
        self._watch("weighing faces", 0, 1)
        guide = choosing(self._guide, self._asset.manifest.face_count)
        teaching, aside = (
            blending_shares(self._asset, lessons, self._device) for lessons in (guide.lessons, guide.aside)
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
            seen, needed = int(100 * (1 - unseen)), round(100 * LEAST_SEEN)
            text = f"{views.said} see {seen} % of its area, and {needed} % are needed"
            raise UsageError("USAGE", f"{text}: give its scene (--scene) or cameras (--cameras)")
        return unseen, None if why_not(self._asset.manifest, "dedicated") else teaching

    def _wanted(self) -> tuple[Sequence[Geometry], list[str]]:
        """Return the geometries to make, and what is to be said of one that is left out."""
        options, count = self._options, self._asset.manifest.face_count
        if options.geometry != "auto":
            return [options.geometry], []
        if options.for_solid:
            if self._guide.has_look and options.faces is None and _is_solid(self._asset):
                return ["kept"], ["its own triangles are kept, which are a solid already"]
            return _FOR_SOLID, []
        if options.faces is not None:
            return ["fitted"], []
        if self._are_small(count):
            return ["kept"], [f"fitted is not tried with {count:,} faces, which pictures are too small for"]
        return ["kept", "fitted"], []

    def _are_small(self, count: int) -> bool:
        """Return whether pictures have too few pixels to move so many faces."""
        return count * FEWEST > min(self._taught.largest, PIXELS_TO_MOVE)

    def _look(self, name: Geometry, mesh: Mesh) -> Look:
        """Return where the colours of what was made go: a texture of tiny triangles would be ten times the
        bytes of colours at their corners."""
        options = self._options
        is_free = options.color is None and options.texture is None
        if name == "fitted" and is_free and self._are_small(len(mesh.faces)):
            return "vertex"
        return choose_look(options, name, self._asset)

    def _made(self, name: Geometry, shares: Shares | None) -> tuple[Mesh, list[str]]:
        """Return the mesh of a geometry, in rough colours, and what should be known of it."""
        options = self._options
        if name == "kept":
            has_holes = self._asset.manifest.appearance.get("alpha_cutoff") is not None
            return kept(self._asset, self._guide, shares), [_OPAQUE] if has_holes else []
        # A surface has its number of faces from the end, not from the soup that it is made of.
        most = options.faces if name == "fitted" else None
        if most not in self._soups:
            seconds = self._seconds(_SEARCH if name == "fitted" else _SURFACE)
            self._soups[most] = fitted(
                self._asset, self._guide, shares, seconds=seconds, faces=most, pixels=self._pixels
            )
        soup, notes = self._soups[most]
        if name == "fitted":
            return soup, notes
        seconds = self._seconds(_SURFACE)
        mesh, more = surface(soup, self._guide, faces=options.faces, pixels=self._pixels, seconds=seconds)
        return mesh, [*(f"of the soup it is made of: {note}" for note in notes), *more]

    def _seconds(self, share: float) -> float:
        """Return how long a search may take."""
        return max(share * self._options.seconds, _NO_TIME)

    def levels(
        self, name: Geometry, mesh: Mesh, shares: Sequence[float]
    ) -> tuple[list[tuple[Level, Mesh]], list[str]]:
        """Return the levels of detail of the geometry that was made, with a texture as large as its own, and
        what should be known of them."""
        if not shares:
            return [], []
        size = mesh.textures[0].shape[0] if mesh.textures else None
        seconds = self._seconds(_SEARCH)
        whole = mesh if size is None else self._rough
        assert whole is not None
        made = lods(whole, self._guide, shares, seconds=seconds)
        found, said = [], []
        for share in shares:
            try:
                one, notes = next(made)
            except AssetError as error:
                said.append(f"there is no level with {share:g} of the faces or fewer: {error.message}")
                break
            look: Look = "vertex" if size is None else "texture"
            level = self._colored(name, one, look, self._taught, size)
            own = self.measure(level)[0]
            facts = len(level.faces), None if own is None else own.after_16, screen_share(mesh, level)
            found.append((Level(share, *facts), level))
            said += [f"of the level with {share:g} of the faces: {note}" for note in notes]
        return found, said

    def shape(self, mesh: Mesh, kind: str) -> Collision:
        """Return what stands in for what was made where things bump into it."""
        self._watch("collision", 0, 1)
        cameras = self._taught.within(PIXELS).cameras
        return collide(mesh, kind, cameras, device=self._device)

    def _colored(
        self, name: Geometry, mesh: Mesh, look: Look, lessons: Lessons, size: int | None = None
    ) -> Mesh:
        """Return a mesh as it is written, in the colours that fit lessons best: in bytes at its vertices, or
        in a texture of this size, or of the one that was asked for."""
        shown = lessons.within(_TEXTURED**2 * self._pixels).cameras
        lessons = lessons.with_halves(self._pixels)
        self._watch("colours", 0, 1)
        has_texture = look == "texture"  # which begins with these colours, and corrects them
        mesh = colored(mesh, few_of(lessons) if has_texture else lessons, self._device)
        if has_texture:
            self._watch("texture", 0, 1)
            size = size or self._options.texture
            mesh = textured(
                mesh,
                lessons,
                size,
                shown=shown,
                continues=name == "surface",
                device=self._device,
                watch=self._watch,
            )
            if name == "kept":
                mesh = rejoined(mesh)
        else:
            assert mesh.vertex_colors is not None
            colors = np.floor(mesh.vertex_colors.clip(0, 1) * 255 + np.float32(0.5))
            mesh = replace(mesh, vertex_colors=colors.astype(np.uint8))
        return replace(mesh, up=written_up(self._asset))

    def measure(self, mesh: Mesh) -> tuple[Psnr | None, Psnr | None]:
        """Return the numbers of the views held back: against the own look, and against photographs."""
        return measured(self._asset, asset_from_mesh(mesh), self._views, self._master, self._device)
