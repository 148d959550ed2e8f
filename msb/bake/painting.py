"""A mesh with a texture, on the standard tier, and what pictures of it ask of each texel."""

from collections.abc import Iterator

import numpy as np

from msb.bake.lessons import Lessons
from msb.bake.raster import Pupil
from msb.bake.stencils import Pyramid
from msb.cl import Buffer, Device, sort_pairs
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render.device_scope import in_turn

_GROUP, _ROWS = 64, 8  # work-group sizes: pixels, and rows of texels
_WAYS = 16  # words per face that the kernels keep


class Painting(Pupil):
    """Draws a mesh with a square texture as the lessons' cameras see it."""

    def __init__(self, mesh: Mesh, lessons: Lessons, device: str | Device | None = None) -> None:
        super().__init__(asset_from_mesh(mesh), lessons, device)
        assert mesh.corner_uvs is not None
        self._own = self._device.program("bake_texture", self._triangles.defines)
        with self._scope.setting_up():
            self._faces = [
                self._device.upload(np.ascontiguousarray(array, np.float32), "bake texture")
                for array in (mesh.vertices[mesh.faces], mesh.corner_uvs)
            ]

    def ask(self, pyramid: Pyramid) -> Iterator[int]:
        """Add to the equations of a texture what the lessons' pictures lack; yield how many are done.

        The sums of a texel are taken along its pixels in their order, and view by view: the same bits each
        time.
        """
        with self._scope.turn():
            starts = self._device.upload(pyramid.starts.astype(np.int32), "bake texture")
        shape = starts, np.int32(pyramid.size), np.int32(pyramid.levels)
        for number in range(len(self.lessons)):
            self._add(number, pyramid, shape)
            yield number + 1

    @in_turn
    def _add(self, number: int, pyramid: Pyramid, shape: tuple[Buffer, np.int32, np.int32]) -> None:
        """Queue what a view adds."""
        planes, view, count = self._drawn(number)
        texels = np.uint32(pyramid.starts[-1])
        keys = self._scratch("texels", 2 * count, np.uint32)
        found = self._scratch("samples", (2 * count, 4)), self._scratch("errors", (count, 4))
        width = np.int32(self.lessons.cameras[number].width)
        shown = planes["face_id"], planes["image"], self._target(number)
        faces = self._faces[0].shape[0]
        ways = self._scratch("ways", (faces, _WAYS))
        self._own.faces(faces, _GROUP, *self._faces, view, shape[1], ways, np.uint32(faces))
        of_pixels = *shown, *shape, width, texels, keys, *found, np.uint32(count)
        self._own.samples(count, _GROUP, *self._faces, view, ways, *of_pixels)
        bits = int(texels).bit_length()
        listed = sort_pairs(self._device, keys, bits=bits, name="bake texels")
        weight = np.float32(self.lessons.weights[number])
        for parity in range(2):
            how = np.int32(parity), weight, pyramid.equations, np.uint32(2 * count)
            self._own.add(-(-int(pyramid.sides.sum()) // 2), _ROWS, *listed, *found, *shape, *how)
