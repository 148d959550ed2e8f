"""An asset's textures on the device: all levels of all textures in one buffer, and their offsets."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import LINEAR, ROUNDING, Sampler, Textured, level_sizes, levels_read
from msb.cl import Buffer, Device
from msb.errors import DeviceError

# Number of header rows, and rows per texture, in the table that zbuffer_texture.cl documents.
_FIRST_ROW, _TEXTURE_ROWS = 2, 5
_WRAPS = {"repeat": 0, "clamp": 1, "mirror": 2}
_DEFINES = {
    "FIRST_ROW": _FIRST_ROW,
    "TEXTURE_ROWS": _TEXTURE_ROWS,
    "CLAMPED": _WRAPS["clamp"],
    "MIRRORED": _WRAPS["mirror"],
}
# Maximum number of texels; the kernels number texels with an int.
_MOST = 2**31 - 1
# Maps an sRGB byte to linear light with 16 bits.
_LINEAR = np.rint(LINEAR * 65535).astype(np.uint16)


@dataclass(frozen=True)
class Texels:
    """The buffers that zbuffer_texture.cl reads, besides triangles and their vertex colours."""

    # The texels (N, 4) uint16 and the table (R, 4) int32. With several textures, the texture numbers (slots,)
    # come first.
    buffers: tuple[Buffer, ...]
    defines: dict[str, int]
    tinted: bool
    several: bool

    def preparation(self, tint: Buffer, face_textures: Buffer) -> tuple[Any, ...]:
        """Return the texture arguments of the kernel `records` in zbuffer_prepare.cl."""
        return tint, np.int32(self.tinted), face_textures, np.int32(self.several), self.buffers[0]


def put_texels(device: Device, textured: Textured, slots: int, *, tinted: bool) -> Texels:
    """Upload the textures to `device`; the texture numbers of the `slots` are filled in later.

    Raises
    ------
    DeviceError
        DEVICE_MEMORY: the textures do not fit.
    """
    sampler = textured.sampler
    sizes = [level_sizes(*image.shape[:2])[: None if sampler.mipmaps else 1] for image in textured.images]
    # Every level has one more row and one more column than its image, for the texels beyond the wrapped edge.
    count = sum((height + 1) * (width + 1) for levels in sizes for height, width in levels)
    if count > _MOST:
        text = f"the textures have {count:,} texels with their mip levels; a device accepts at most {_MOST:,}"
        raise DeviceError("DEVICE_MEMORY", text)
    # np.zeros allocates huge pages, which the device uses if it shares the host's memory.
    texels = device.share(np.zeros((count, 4), np.uint16), "standard textures", "appearance")
    rows = np.zeros((_FIRST_ROW + _TEXTURE_ROWS * len(sizes), 4), np.int32)
    wraps = (_WRAPS[wrap] for wrap in (sampler.wrap_u, sampler.wrap_v))
    # Row 0: filter, mip maps and wrap modes. Row 1: the alpha cutoff, and whether vertex colours and several
    # textures exist.
    rows[0] = (sampler.filter == "nearest", sampler.mipmaps, *wraps)
    several = textured.face_texture is not None
    rows[1, :3] = np.float32((sampler.alpha_cutoff or 0) - ROUNDING).view(np.int32), tinted, several
    first = 0
    # The following rows describe each texture: width, height, last level, and the first texel of each level.
    for number, image in enumerate(textured.images):
        levels = levels_read(image, sampler)
        numbers = rows[_FIRST_ROW + _TEXTURE_ROWS * number :].reshape(-1)
        numbers[:3] = image.shape[1], image.shape[0], len(levels) - 1
        for level, texture in enumerate(levels):
            height, width = texture.shape[:2]
            numbers[4 + level] = first
            texels.write(pack(_add_border(texture, sampler)), start=4 * first)
            first += (height + 1) * (width + 1)
    buffers = (
        device.allocate(slots if several else 1, np.uint32, "standard texture numbers", "appearance"),
        texels,
        device.upload(rows, "standard texture rows", "appearance"),
    )
    defines = {**_DEFINES, "CUTOFF": int(sampler.alpha_cutoff is not None)}
    return Texels(buffers, defines, tinted, several)


def _add_border(image: NDArray[np.uint8], sampler: Sampler) -> NDArray[np.uint8]:
    """Return a mip level with one more column and row, which contain the next texels in the wrap mode."""
    for axis, wrap in enumerate((sampler.wrap_v, sampler.wrap_u)):
        widths = [(0, 0)] * 3
        widths[axis] = (0, 1)
        image = np.pad(image, widths, "wrap" if wrap == "repeat" else "edge")
    return image


def pack(image: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return texels (H, W, 3 | 4) as linear light and alpha, (H W, 4) uint16."""
    texels = np.full((*image.shape[:2], 4), 65535, np.uint16)
    texels[..., :3] = _LINEAR[image[..., :3]]
    if image.shape[2] == 4:
        texels[..., 3] = image[..., 3] * np.uint16(257)
    return texels.reshape(-1, 4)
