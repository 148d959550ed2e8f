"""The passes and buffers of a frame as plain data, which wgpu-py and a browser's WebGPU execute."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from numpy.typing import NDArray

# Number of bytes between separately bound entries of a uniform buffer; WebGPU requires multiples of 256.
SLOT = 256
# Blend factors of source and target for blending from front to back with premultiplied colours.
FRONT_TO_BACK = "one-minus-dst-alpha", "one"


@dataclass(frozen=True)
class Binding:
    """A binding of group 0: a texture or a range of a buffer.

    The range has `size` bytes from `offset` on. Without `size`, the range is the whole buffer.

    A buffer has the `kind` "uniform", "read" or "write". A texture has the `kind` "texture" (float),
    "numbers" (uint32), or "store" (written as r32float). If `per_band` is true, every band has a different
    offset.
    """

    number: int
    kind: str
    name: str
    offset: int = 0
    size: int | None = None
    per_band: bool = False


@dataclass(frozen=True)
class ComputePass:
    """A compute dispatch of the entry point `entry`.

    `groups` is the number of workgroups. If `groups` is None, the GPU reads the number at byte `indirect` of
    the buffer `arguments`. If `groups` and `indirect` are both None, the pass has one invocation per pixel of
    the band. In a pass over pixels, a workgroup processes 64 pixels of a row.
    """

    stage: str
    module: str
    entry: str
    bindings: tuple[Binding, ...]
    groups: int | None = None
    indirect: int | None = None


@dataclass(frozen=True)
class DrawPass:
    """A render pass with one indirect draw for each buffer of face records."""

    stage: str
    module: str
    bindings: tuple[Binding, ...]
    targets: tuple[str, ...]
    # The record buffers, each with the byte offset of its draw arguments in the buffer `arguments`.
    records: tuple[tuple[str, int], ...]
    # Number of vec4 members of a record; each member is a vertex attribute, at locations 0, 1, ...
    members: int
    # Load operation of the render targets: "clear" or "load".
    load: str = "clear"
    # Whether to keep the nearest face (entry point `nearest`) instead of blending (entry point `blend`).
    z_buffer: bool = False


@dataclass(frozen=True)
class Plan:
    """The passes of a frame: `passes` run once, and `band_passes` run for each band of the frame."""

    # Name -> WGSL.
    modules: Mapping[str, str]
    # The size in bytes and the usages of each buffer, by name.
    buffers: Mapping[str, tuple[int, tuple[str, ...]]]
    # The content of each buffer that is uploaded only once, by name.
    data: Mapping[str, NDArray[Any]]
    passes: tuple[ComputePass, ...]
    band_passes: tuple[DrawPass | ComputePass, ...]
    # Texture format of the render targets. Render targets have the size of a band in samples.
    format: str
    # Samples per pixel along each axis.
    scale: int
    # Blend factors (source, target) of colour and of alpha.
    blend: tuple[tuple[str, str], tuple[str, str]] = (FRONT_TO_BACK, FRONT_TO_BACK)
    # Initial alpha of the render targets; the initial colours are 0.
    clear: float = 0.0

    def record(self) -> dict[str, Any]:
        """Return the plan without `data` as JSON data for the browser page."""
        return {key: value for key, value in asdict(replace(self, data={})).items() if key != "data"}


@dataclass(frozen=True)
class Limits:
    """Limits of a device: bytes of a storage binding, bytes of a buffer, width and height of a texture."""

    binding: int
    buffer: int
    side: int

    @property
    def storage(self) -> int:
        """Maximum number of bytes of a buffer that is bound as storage."""
        return min(self.binding, self.buffer)
