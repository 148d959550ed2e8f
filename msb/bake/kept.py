"""The model's own triangles: those with which an opaque picture is best, in the best static colours."""

from msb.asset import Asset
from msb.bake.raster import Raster
from msb.bake.search import try_faces
from msb.bake.shares import Shares
from msb.bake.soup import Soup, is_uncut_soup, without_seams
from msb.bake.start import Best, Guide, choose, plain_mesh
from msb.meshes.mesh import Mesh
from msb.repair.assets import repair_mesh
from msb.repair.plan import Options

# Rounds that hide and show faces, rounds between validations, and validations without a gain that end it.
_ROUNDS, _REFIT, _PATIENCE = 60, 5, 6
_PIXELS = 1 << 17  # pixels of the largest image that selects faces; colours are fitted to larger ones
FINE = 4.0  # mean pixels of a face in a view, below which images of four times the size select faces
FEWEST = 2.0  # mean pixels of a face in a view, below which a search would follow noise


def kept(asset: Asset, guide: Guide, shares: Shares | None = None) -> Mesh:
    """Return the triangles of `asset` that are shown, with the static colours that the lessons ask for.

    Which triangles are left out, pictures say that teach nothing; of a model that is its own look none is.
    Vertices that triangles share stay shared, and have one colour; of a mesh, what is not manifold or not
    consistently wound is repaired. A triangle that no view sees keeps its colour.

    Raises
    ------
    DeviceError, and as `mesh_from_asset` where the asset has no triangles to show.
    """
    plain = plain_mesh(asset)
    soup = Soup.of(plain, shares=True)
    mesh = None if soup.shared is None else plain
    del plain  # of millions of faces it is much, and of a soup no longer needed
    if not guide.has_look:
        guide.watch("choosing faces", 0, _ROUNDS)
        with choosing(guide, soup.count).rasters(soup) as (raster, judge):
            best = Best(judge)
            choose(soup, asset, raster, best, shares)
            if raster.pixels_a_face(soup.count) >= FEWEST:
                _search(best.soup, raster, best, guide)
            soup = best.soup
    return soup.mesh() if mesh is None else repair_mesh(soup.on(mesh), Options())[0]


def rejoined(mesh: Mesh) -> Mesh:
    """Return a kept mesh that has a texture without the cuts that colours at its vertices needed."""
    if is_uncut_soup(mesh.vertices, mesh.faces):
        return mesh
    whole = without_seams(mesh)
    if whole is mesh:
        return mesh
    # Faces that met at a cut were not repaired there; what a repair had cut, it cuts again.
    repaired = repair_mesh(whole, Options())[0]
    return repaired if len(repaired.vertices) < len(mesh.vertices) else mesh


def choosing(guide: Guide, faces: int) -> Guide:
    """Return what guides the choice among so many faces: by larger pictures if only those show them well."""
    usual, larger = guide.within(_PIXELS), guide.within(4 * _PIXELS)
    is_fine = usual.lessons.largest >= FINE * faces or larger.lessons.largest < FEWEST * faces
    return usual if is_fine else larger


def _search(soup: Soup, raster: Raster, best: Best, guide: Guide) -> None:
    """Hide faces, and show those that are hidden, as long as views aside look better for it."""
    random = guide.random()
    for step in range(1, _ROUNDS + 1):
        try_faces(soup, raster, random)
        enough = guide.watch("choosing faces", step, _ROUNDS)
        if enough or step % _REFIT == 0:
            soup.refit(raster)
            best.look(soup)
            if enough or best.since >= _PATIENCE:
                return
