"""A standard-tier renderer of a textured mesh that sums the least-squares equations of the texels."""

from collections.abc import Iterator

import numpy as np

from msb.bake.images import ViewImages
from msb.bake.soup_renderer import SupervisedRenderer
from msb.bake.texture_equations import TextureEquations
from msb.base.origin import NO_ORIGIN
from msb.cl import Buffer, Device, sort_pairs
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.device_scope import in_turn

# Number of work-items in a work-group: for pixels, and for rows of texels.
_GROUP, _ROW_GROUP = 64, 8
# Number of floats per face in bake_texture.cl. These values are the coefficients of the face's texture
# coordinates, and the bounds.
_FACE_FLOATS = 16


class TextureRenderer(SupervisedRenderer):
    """Draws a mesh with a square texture from the cameras of target images."""

    def __init__(self, mesh: Mesh, images: ViewImages, device: str | Device | None = None) -> None:
        super().__init__(asset_from_mesh(mesh, origin=NO_ORIGIN), images, device)
        assert mesh.corner_uvs is not None
        self._kernels = self._device.program("bake_texture", self._triangles.defines)
        with self._scope.setting_up():
            self._faces = [
                self._device.upload(np.ascontiguousarray(array, np.float32), "bake texture")
                for array in (mesh.vertices[mesh.faces], mesh.corner_uvs)
            ]

    def add_equations(self, equations: TextureEquations) -> Iterator[int]:
        """Add the differences from target images to the equations. Yield the number of finished views.

        The pixels of a texel are added view by view in a fixed order, so that results are reproducible.
        """
        with self._scope.turn():
            starts = self._device.upload(equations.starts.astype(np.int32), "bake texture")
        shape = starts, np.int32(equations.size), np.int32(equations.levels)
        for number in range(len(self.images)):
            self._add_view(number, equations, shape)
            yield number + 1

    @in_turn
    def _add_view(
        self, number: int, equations: TextureEquations, shape: tuple[Buffer, np.int32, np.int32]
    ) -> None:
        """Queue the sums over one view.

        The argument `shape` is a tuple: the first texels of the levels, the size, and the number of levels.
        """
        planes, view, count = self._draw_view(number)
        texels = np.uint32(equations.starts[-1])
        # The sort key of a sample is the first of its four texels. A pixel has samples in two neighbouring
        # mip levels.
        keys = self._scratch("texels", 2 * count, np.uint32)
        samples = self._scratch("samples", (2 * count, 4)), self._scratch("errors", (count, 4))
        width = np.int32(self.images.cameras[number].width)
        drawn = planes["face_id"], planes["image"], self._load_target(number)
        # Compute linear forms of the texture coordinates of each face, then the samples of each pixel.
        faces = self._faces[0].shape[0]
        forms = self._scratch("ways", (faces, _FACE_FLOATS))
        self._kernels.faces(faces, _GROUP, *self._faces, view, shape[1], forms, np.uint32(faces))
        pixels = *drawn, *shape, width, texels, keys, *samples, np.uint32(count)
        self._kernels.samples(count, _GROUP, *self._faces, view, forms, *pixels)
        # Sort the samples by texel, and add them up row by row. Rows that run in parallel must not change the
        # same texels. Neighbouring rows share texels, so add the even rows first, then the odd rows.
        ordered = sort_pairs(self._device, keys, bits=int(texels).bit_length(), name="bake texels")
        weight = np.float32(self.images.weights[number])
        rows = -(-int(equations.sides.sum()) // 2)
        for parity in range(2):
            settings = np.int32(parity), weight, equations.stencils, np.uint32(2 * count)
            self._kernels.add(rows, _ROW_GROUP, *ordered, *samples, *shape, *settings)
