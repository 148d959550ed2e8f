"""The stages of a bake from its images to its meshes: candidates, choice, colours, levels and collision."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from msb.api.auditing import audit
from msb.asset import Asset
from msb.asset.look import stored_threshold, visible_faces, written_up
from msb.asset.tiers import why_not
from msb.bake.blending_weights import BlendingWeights, measure_blending_weights
from msb.bake.candidate_fitted import PIXELS_TO_MOVE, make_fitted
from msb.bake.candidate_kept import (
    FINE_PIXELS,
    MIN_FACE_PIXELS,
    limit_for_selection,
    make_kept,
    rejoin_cuts,
)
from msb.bake.candidate_surface import make_surface
from msb.bake.collision import PIXELS as COLLISION_PIXELS
from msb.bake.collision import Collision, make_collision
from msb.bake.context import ProgressHook, SearchContext
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.images import ViewImages
from msb.bake.lods import make_lods, measure_screen_share
from msb.bake.options import BakeOptions, ColorTarget, Geometry
from msb.bake.quality import measure_psnr, measure_quality
from msb.bake.report import LodReport, Psnr, Verdict, describe_choice
from msb.bake.requirements import choose_color_target
from msb.bake.simplification import is_closed_surface
from msb.bake.texture import fit_texture, select_first_pass
from msb.bake.vertex_colors import fit_vertex_colors
from msb.bake.views import BakeViews
from msb.base.origin import NO_ORIGIN
from msb.errors import AssetError, UsageError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.topology.faces import face_areas

# Share of the time limit `seconds` for the movement of fitted triangles, and for each level of detail.
_FITTED_SHARE = 2 / 3
# Share of the time limit `seconds` for each of the two searches of a surface. The first search fits the soup
# for the depth maps, and the second search moves the vertices. The remaining steps have no time limit, so a
# surface takes about 1.5 times as long as fitted triangles.
_SURFACE_SHARE = 0.4
# Smallest time limit of a search in seconds. Within this time, a search makes a single step.
_MIN_SECONDS = 1e-3
# The texture size is halved if the PSNR loss is at most this number of dB. The PSNR loss is the average of
# two values, for images with 1 and with 16 samples per pixel.
_MAX_TEXTURE_LOSS = 0.02
_SAMPLES = (1, SAMPLES_PER_SIDE)
# Smallest number of texels along a side of a texture with automatic size.
_MIN_TEXTURE_SIDE = 256
# Smallest number of texels per face in the texture of a level of detail. A face of a soup and its margin need
# about 4 texels.
_TEXELS_PER_FACE = 8
# Scale of the training images: their width and height relative to the views. Training images of the same size
# as the views would give a texture that looks blurred in the views. Moved faces would also follow the
# aliasing of these images, which lowered PSNR by 1.3 dB.
_IMAGE_SCALE = 2
_SOLID_CANDIDATES: tuple[Geometry, ...] = ("fitted", "surface")
_OPAQUE_NOTE = (
    "the baked triangles are opaque; parts that alpha cut off show the colour of the surface behind them"
)


def _choose_texture_side(whole: int, share: float, faces: int) -> int:
    """Return the side of a level's texture in texels.

    The side is a power of two. The argument `share` is the level's share of the texels. Each of the `faces`
    gets a few texels. The level's texture is never larger than the whole texture.
    """
    least = min(whole, 1 << math.ceil(math.log2(math.sqrt(_TEXELS_PER_FACE * max(faces, 1)))))
    return max(least, 1 << int(math.log2(whole * math.sqrt(share)) + 1e-9))


def _is_solid(asset: Asset) -> bool:
    return Verdict.of(audit(asset)).level == "ok"


@dataclass(frozen=True)
class Choice:
    """The chosen geometry, the unseen share of the model's area, the candidates' PSNR, and notes."""

    geometry: Geometry
    unseen_area: float
    tried: dict[str, float]
    notes: tuple[str, ...]


class BakePipeline:
    """The training and validation images of a bake, and the stages of the bake that use these images.

    Parameters
    ----------
    asset : Asset
        The model.
    views : BakeViews
    source : ImageSource
        Draws the images of the views.
    options : BakeOptions
    device : str, optional
        The OpenCL device.
    progress : callable
        As in `SearchContext`.
    """

    def __init__(
        self,
        asset: Asset,
        views: BakeViews,
        source: ImageSource,
        options: BakeOptions,
        device: str | None,
        progress: ProgressHook,
    ) -> None:
        self._asset, self._views, self._source, self._options = asset, views, source, options
        self._device, self._progress = device, progress
        self._is_splat = asset.manifest.primitive == "gaussian"
        self._pixels = max(camera.width * camera.height for camera in views.all_but_test)
        self._images = source.training_images(views.all_but_test, self._choose_image_scale())
        # Validation views come last. Without validation views, use the training views for the validation.
        first = range(len(views.all_but_test) - len(views.validation))
        self._training = self._images.select(first)
        self._validation = self._images.select(range(len(first), len(views.all_but_test)) or first)
        is_mesh = why_not(asset.manifest, "dedicated") is not None and source.supervision == "native"
        self._context = SearchContext(
            self._training,
            self._validation,
            options.seed,
            device,
            progress,
            is_mesh,
            options.step_factor,
            self._is_splat,
        )
        self._soups: dict[int | None, tuple[Mesh, list[str]]] = {}
        self._untextured: Mesh | None = None

    def _choose_image_scale(self) -> int:
        """Return the scale of the training images relative to the views.

        Larger images show the borders of faces more precisely, so the training images are larger than small
        views. Use the scale 1 if no face moves, no texture is fitted, and the faces cover enough pixels.
        Images at scale 1 are rendered in a quarter of the time. For Gaussians, the scale is always 1.
        Renderers widen Gaussians by a part of a pixel, so Gaussians would be thinner in larger images.
        """
        if self._is_splat:
            return 1
        if (2 * _IMAGE_SCALE) ** 2 * self._pixels <= PIXELS_TO_MOVE:
            return 2 * _IMAGE_SCALE
        options = self._options
        is_static = (
            options.geometry == "kept" and choose_color_target(options, "kept", self._asset) == "vertex"
        )
        has_pixels = self._pixels >= FINE_PIXELS * self._asset.manifest.face_count
        return 1 if is_static and has_pixels and not options.lod_shares else _IMAGE_SCALE

    def close(self) -> None:
        """Delete the stored images of the bake."""
        for images in (self._training, self._validation, self._images):
            images.close()

    def make_mesh(self, stopped: Callable[[], bool]) -> tuple[Mesh, Choice]:
        """Return the final mesh for files, and the choice between its candidates."""
        self._progress("looking at the model", 0, len(self._images))
        for number in range(len(self._images)):
            self._images.stored_image(number)
            self._progress("looking at the model", number + 1, len(self._images))
        self._source.release()
        unseen, weights = self._measure_visibility()
        candidates, notes = self._list_candidates()
        mesh, choice = self._choose_mesh(candidates, notes, unseen, weights, stopped)
        if (
            self._options.for_solid
            and choice.geometry == "kept"
            and not is_closed_surface(mesh.vertices, mesh.faces)
        ):
            return self._choose_mesh(_SOLID_CANDIDATES, [], unseen, weights, stopped)
        return mesh, choice

    def _choose_mesh(
        self,
        names: Sequence[Geometry],
        notes: list[str],
        unseen: float,
        weights: BlendingWeights | None,
        stopped: Callable[[], bool],
    ) -> tuple[Mesh, Choice]:
        """Make the named candidates. Return the chosen candidate with its final colours."""
        candidates: dict[Geometry, Mesh] = {}
        candidate_notes: dict[Geometry, list[str]] = {}
        for name in names:
            if candidates and stopped():
                break
            try:
                candidates[name], candidate_notes[name] = self._make_candidate(name, weights)
            except AssetError as error:
                if not candidates:
                    raise
                notes.append(f"{name} could not be made: {error.message}")
        # Compare the candidates by their validation images. Fit the colours of compared candidates to the
        # training images only.
        tried: dict[str, float] = {}
        if len(candidates) > 1:
            targets = [self._validation.limited_to(self._pixels)]
            for name in reversed(candidates):
                mesh = candidates[name]
                colored = self._fit_colors(name, mesh, self._choose_color_target(name, mesh), self._training)
                self._progress("comparing", 0, 1)
                asset = asset_from_mesh(colored, origin=NO_ORIGIN)
                tried[name] = measure_psnr(asset, targets, SAMPLES_PER_SIDE, self._device)[0]
        chosen, why = self._choose_candidate(candidates, tried)
        notes += candidate_notes[chosen]
        if (
            self._options.lod_shares
        ):  # A level of detail starts with the vertex colours, not with the texture.
            self._untextured = candidates[chosen]
        if stopped():
            notes.append("interrupted; the result is the best state until the interruption")
        # The final colours are fitted to all images.
        target = self._choose_color_target(chosen, candidates[chosen])
        size = None
        if target == "texture" and not stopped():
            size = self._options.texture or self._choose_texture_size(chosen, candidates[chosen])
        mesh = self._fit_colors(chosen, candidates[chosen], target, self._images, size)
        if why:
            notes.append(f"{why}. {describe_choice(tried)}")
        if not self._is_splat and (dropped := self._asset.manifest.face_count - len(mesh.faces)):
            plural = "s" if abs(dropped) > 1 else ""
            more_or_fewer = "fewer" if dropped > 0 else "more"
            notes.append(f"the mesh has {abs(dropped):,} {more_or_fewer} triangle{plural} than the model")
        return mesh, Choice(chosen, unseen, tried, tuple(notes))

    def _choose_texture_size(self, name: Geometry, mesh: Mesh) -> int:
        """Return the number of texels along a side: the default, or less at the same quality.

        A texture with too many texels wastes bytes and causes aliasing in engines that take one sample per
        pixel.
        """
        targets = [self._validation.limited_to(self._pixels)]

        def measure(size: int | None) -> tuple[int, float]:
            fitted = self._fit_colors(name, mesh, "texture", self._training, size)
            asset = asset_from_mesh(fitted, origin=NO_ORIGIN)
            values = [measure_psnr(asset, targets, samples, self._device)[0] for samples in _SAMPLES]
            return fitted.textures[0].shape[0], sum(values) / len(values)

        size, psnr = measure(None)
        while size > _MIN_TEXTURE_SIDE:
            try:
                half, half_psnr = measure(size // 2)
            except UsageError:  # The faces do not fit into half the texture.
                break
            if half_psnr < psnr - _MAX_TEXTURE_LOSS:
                break
            size, psnr = half, half_psnr
        return size

    def _choose_candidate(
        self, candidates: dict[Geometry, Mesh], tried: dict[str, float]
    ) -> tuple[Geometry, str]:
        """Return the name of the chosen candidate, and the reason if several candidates were compared."""
        best = max(candidates, key=lambda name: tried.get(name, 0.0))
        if not tried:
            return best, ""
        if "surface" not in candidates:
            return best, f"{best} was chosen as the better result of kept and fitted"
        verdict = Verdict.of(audit(asset_from_mesh(candidates["surface"])))
        if verdict.level == "bad":
            return "fitted", f"fitted was chosen, because the verdict on the surface is BAD: {verdict.reason}"
        return "surface", "surface was chosen, because tools for solids need a closed surface"

    def _measure_visibility(self) -> tuple[float, BlendingWeights | None]:
        """Return the share of the area that no view shows, and the blending weights of the faces."""
        if self._is_splat and self._list_candidates()[0] == ["surface"]:
            return 0.0, None
        self._progress("weighing faces", 0, 1)
        context = limit_for_selection(self._context, self._asset.manifest.face_count)
        training, validation = (
            measure_blending_weights(self._asset, images, self._device)
            for images in (context.training, context.validation)
        )
        if training is None or validation is None:
            return 0.0, None
        buffers = self._asset.buffers
        area = face_areas(buffers["positions"], buffers["indices"])[0]
        visible = visible_faces(self._asset, stored_threshold(self._asset))
        if visible is not None:
            area[~visible] = 0.0
        unseen = float(area[training.weight + validation.weight == 0].sum() / max(area.sum(), 1e-300))
        return unseen, None if why_not(self._asset.manifest, "dedicated") else training

    def _list_candidates(self) -> tuple[Sequence[Geometry], list[str]]:
        """Return the names of the candidates to make, and notes on candidates that are left out."""
        options = self._options
        if options.geometry != "auto":
            return [options.geometry], []
        if (
            self._is_splat
        ):  # Assets of Gaussians contain placeholder triangles, which are not used as a candidate.
            return ["surface"], []
        if options.for_solid:
            if self._context.shows_model_mesh and options.faces is None and _is_solid(self._asset):
                return ["kept"], ["the model is a closed mesh already, so its triangles are kept"]
            return _SOLID_CANDIDATES, []
        if options.faces is not None:
            return ["fitted"], []
        return ["kept", "fitted"], []

    def _has_small_faces(self, count: int) -> bool:
        """Return whether the images have too few pixels to move `count` faces."""
        return count * MIN_FACE_PIXELS > min(self._images.max_pixels, PIXELS_TO_MOVE)

    def _choose_color_target(self, name: Geometry, mesh: Mesh) -> ColorTarget:
        """Return whether a candidate has its colours in a texture or at the vertices.

        Tiny fitted triangles have vertex colours by default, because a texture would need ten times the
        bytes.
        """
        options = self._options
        is_free = options.color is None and options.texture is None
        if name == "fitted" and is_free and self._has_small_faces(len(mesh.faces)):
            return "vertex"
        return choose_color_target(options, name, self._asset)

    def _make_candidate(self, name: Geometry, weights: BlendingWeights | None) -> tuple[Mesh, list[str]]:
        """Return a candidate with rough vertex colours, and notes for the user."""
        options = self._options
        if name == "kept":
            has_cutoff = self._asset.manifest.appearance.get("alpha_cutoff") is not None
            return make_kept(self._asset, self._context, weights), [_OPAQUE_NOTE] if has_cutoff else []
        source: Mesh | Asset = self._asset
        notes: list[str] = []
        if name == "fitted" or not self._is_splat:
            # `--faces` limits the surface itself. `--faces` does not limit the soup from which the surface is
            # made.
            budget = options.faces if name == "fitted" else None
            if budget not in self._soups:
                seconds = self._limit_seconds(_FITTED_SHARE if name == "fitted" else _SURFACE_SHARE)
                self._soups[budget] = make_fitted(
                    self._asset, self._context, weights, seconds=seconds, faces=budget, pixels=self._pixels
                )
            source, notes = self._soups[budget]
            if name == "fitted":
                return source, notes
        mesh, surface_notes = make_surface(
            source,
            self._context,
            faces=options.faces,
            pixels=self._pixels,
            seconds=self._limit_seconds(_SURFACE_SHARE),
        )
        return mesh, [*(f"triangle soup for the surface: {note}" for note in notes), *surface_notes]

    def _limit_seconds(self, share: float) -> float:
        """Return the time limit in seconds of a search with this share of the option `seconds`."""
        seconds = self._options.seconds
        return math.inf if seconds is None else max(share * seconds, _MIN_SECONDS)

    def make_levels(
        self, name: Geometry, mesh: Mesh, shares: Sequence[float]
    ) -> tuple[list[tuple[LodReport, Mesh]], list[str]]:
        """Return the levels of detail of the chosen mesh, and notes for the user.

        The number of texels falls with the number of faces. The side is rounded down to a power of two.
        """
        if not shares:
            return [], []
        size = mesh.textures[0].shape[0] if mesh.textures else None
        whole = mesh if size is None else self._untextured
        assert whole is not None
        lods = make_lods(whole, self._context, shares, seconds=self._limit_seconds(_FITTED_SHARE))
        levels, notes = [], []
        for share in shares:
            try:
                lod, lod_notes = next(lods)
            except AssetError as error:
                notes.append(
                    f"levels of detail with {100 * share:g} % of the faces or fewer were not made: "
                    f"{error.message}"
                )
                break
            side = None if size is None else _choose_texture_side(size, share, len(lod.faces))
            colored = self._fit_colors(name, lod, "vertex" if size is None else "texture", self._images, side)
            native = self.measure(colored)[0]
            quality = None if native is None else native.after_16
            screen_share = measure_screen_share(mesh, colored)
            levels.append((LodReport(share, len(colored.faces), quality, screen_share), colored))
            notes += [f"level of detail with {100 * share:g} % of the faces: {note}" for note in lod_notes]
        return levels, notes

    def make_collision(self, mesh: Mesh, kind: str) -> Collision:
        """Return a collision shape of the chosen mesh."""
        self._progress("collision", 0, 1)
        cameras = self._images.limited_to(COLLISION_PIXELS).cameras
        return make_collision(mesh, kind, cameras, device=self._device)

    def _fit_colors(
        self, name: Geometry, mesh: Mesh, target: ColorTarget, images: ViewImages, size: int | None = None
    ) -> Mesh:
        """Return the final mesh for files, with colours fitted to the images.

        Vertex colours are rounded to bytes. A texture has `size` texels along a side. The default is the
        option `texture`.
        """
        cameras = images.limited_to(_IMAGE_SCALE**2 * self._pixels).cameras
        images = images.with_coarser_levels(self._pixels)
        self._progress("colours", 0, 1)
        is_textured = target == "texture"
        # An initial texture only needs colours that are fitted to a few images.
        mesh = fit_vertex_colors(mesh, select_first_pass(images) if is_textured else images, self._device)
        if is_textured:
            self._progress("texture", 0, 1)
            mesh = fit_texture(
                mesh,
                images,
                size or self._options.texture,
                count_cameras=cameras,
                extends_colors=name == "surface",
                device=self._device,
                progress=self._progress,
            )
            if name == "kept":
                mesh = rejoin_cuts(mesh)
        else:
            assert mesh.vertex_colors is not None
            colors = np.floor(mesh.vertex_colors.clip(0, 1) * 255 + np.float32(0.5))
            mesh = replace(mesh, vertex_colors=colors.astype(np.uint8))
        return replace(mesh, up=written_up(self._asset))

    def measure(self, mesh: Mesh) -> tuple[Psnr | None, Psnr | None]:
        """Return the PSNR of a mesh on the test views, to native renderings and to photographs."""
        baked = asset_from_mesh(mesh, origin=NO_ORIGIN)
        return measure_quality(self._asset, baked, self._views, self._source, self._device)
