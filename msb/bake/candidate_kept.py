"""The candidate `kept`: the model's triangles, pruned, with fitted static colours."""

from msb.asset import Asset
from msb.bake.blending_weights import BlendingWeights
from msb.bake.context import BestState, SearchContext
from msb.bake.face_selection import toggle_faces
from msb.bake.opaque_model import hide_stray_faces, prune_faces, to_opaque_mesh
from msb.bake.soup import Soup, is_uncut_soup, merge_seams
from msb.bake.soup_renderer import SoupRenderer
from msb.meshes.mesh import Mesh
from msb.repair.assets import repair_mesh
from msb.repair.plan import Options

# Limits of the face selection: the number of rounds, the rounds between two validations, and the validations
# without a gain before the end. A selection round tries 8 % of the faces, so 60 rounds try each face about
# five times.
_ROUNDS, _VALIDATION_STEP, _PATIENCE = 60, 5, 6
# Number of pixels of the largest image that is used to select faces. Selection takes longer with larger
# images. Colours are always fitted to the full images.
_SELECTION_PIXELS = 1 << 17
# If faces cover fewer pixels than this in an average view, the selection uses images with four times the
# pixels.
FINE_PIXELS = 4.0
# If faces cover fewer pixels than this in an average view, no face is selected or moved. With so few samples
# per face, noise would determine the result.
MIN_FACE_PIXELS = 2.0


def make_kept(asset: Asset, context: SearchContext, weights: BlendingWeights | None = None) -> Mesh:
    """Return the model's triangles after pruning, with vertex colours fitted to the training images.

    The validation images decide which triangles are pruned. If the images are standard-tier images of the
    same triangles, no triangle is pruned. Shared vertices stay shared and have one colour. A mesh that is not
    manifold or not consistently wound is repaired. In a connected mesh, unseen triangles keep their colours.
    From a triangle soup, unseen triangles are dropped.

    Raises
    ------
    DeviceError, and the errors of `mesh_from_asset` if the asset has no visible triangles.
    """
    opaque = to_opaque_mesh(asset)
    soup = Soup.from_mesh(opaque, share_colors=True)
    mesh = None if soup.shared is None else opaque
    del opaque  # Free the soup, because millions of faces take much memory.
    if not context.shows_model_mesh:
        context.progress("choosing faces", 0, _ROUNDS)
        with limit_for_selection(context, soup.selected_count).open_renderers(soup) as renderers:
            renderer, validation = renderers
            best = BestState(validation)
            prune_faces(soup, asset, renderer, best, weights)
            if renderer.pixels_per_face(soup.selected_count) >= MIN_FACE_PIXELS:
                _select_faces(best.soup, renderer, best, context)
            soup = best.soup if mesh is not None else hide_stray_faces(best.soup, renderer, best)
    return soup.to_mesh() if mesh is None else repair_mesh(soup.apply_to(mesh), Options())[0]


def rejoin_cuts(mesh: Mesh) -> Mesh:
    """Remove the cut edges that only vertex colours need. Return the mesh."""
    if is_uncut_soup(mesh.vertices, mesh.faces):
        return mesh
    whole = merge_seams(mesh)
    if whole is mesh:
        return mesh
    # The merged mesh is repaired again, which also restores the cut edges of the first repair.
    repaired = repair_mesh(whole, Options())[0]
    return repaired if len(repaired.vertices) < len(mesh.vertices) else mesh


def limit_for_selection(context: SearchContext, faces: int) -> SearchContext:
    """Return the context with images that are large enough to select among `faces` faces."""
    usual, larger = (context.limited_to(factor * _SELECTION_PIXELS) for factor in (1, 4))
    is_fine = usual.training.max_pixels >= FINE_PIXELS * faces
    is_hopeless = larger.training.max_pixels < MIN_FACE_PIXELS * faces
    return usual if is_fine or is_hopeless else larger


def _select_faces(soup: Soup, renderer: SoupRenderer, best: BestState, context: SearchContext) -> None:
    """Hide and show faces while the validation images improve."""
    random = context.make_random()
    for step in range(1, _ROUNDS + 1):
        toggle_faces(soup, renderer, random)
        stop = context.progress("choosing faces", step, _ROUNDS)
        if stop or step % _VALIDATION_STEP == 0:
            soup.refit_colors(renderer)
            best.evaluate(soup)
            if stop or best.evaluations_since >= _PATIENCE:
                return
