"""The passes and buffers of a frame as plain data, which wgpu-py and a browser's WebGPU run alike."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from numpy.typing import NDArray

# Bytes between entries of a uniform buffer that are bound one at a time.
SLOT = 256
# Blend factors of source and target.
FRONT_TO_BACK = "one-minus-dst-alpha", "one"


@dataclass(frozen=True)
class Binding:
    """A part of a buffer, or a texture, at a number of group 0.

    `kind` is "uniform", "read", "write", "texture" (of floats), "numbers" (a texture of uint32) or "store" (a
    texture that is written, r32float). `per_band` says that `offset` is that of the band.
    """

    number: int
    kind: str
    name: str
    offset: int = 0
    size: int | None = None
    per_band: bool = False


@dataclass(frozen=True)
class Compute:
    """A dispatch: `groups` work-groups, or as many as `arguments` says at a byte offset (`indirect`).

    A dispatch of a band has a work-item for each pixel, by columns of 64 (`groups` None).
    """

    stage: str
    module: str
    entry: str
    bindings: tuple[Binding, ...]
    groups: int | None = None
    indirect: int | None = None


@dataclass(frozen=True)
class Draws:
    """A render pass: for each buffer of records a draw, whose numbers `arguments` has at an offset."""

    stage: str
    module: str
    bindings: tuple[Binding, ...]
    targets: tuple[str, ...]
    records: tuple[tuple[str, int], ...]
    # vec4 of a record: attributes at locations 0, 1, ...
    members: int
    # "clear" or "load": what the targets hold before.
    load: str = "clear"
    # Entry point `nearest` instead of `blend`; nothing is blended, the nearest stays.
    z_buffer: bool = False


@dataclass(frozen=True)
class Plan:
    """What a frame is made of: passes that run once, and passes that run for each band of it."""

    # Name -> WGSL.
    modules: Mapping[str, str]
    # Name -> bytes and usages. What `data` holds is uploaded once.
    buffers: Mapping[str, tuple[int, tuple[str, ...]]]
    data: Mapping[str, NDArray[Any]]
    passes: tuple[Compute, ...]
    band_passes: tuple[Draws | Compute, ...]
    # Of the targets `image` and `depth`, whose sizes are those of a band in samples.
    format: str
    # Samples of a pixel along each axis.
    scale: int
    # The factors of source and target, of colour and of alpha.
    blend: tuple[tuple[str, str], tuple[str, str]] = (FRONT_TO_BACK, FRONT_TO_BACK)
    # The alpha that targets begin with; their colours begin with 0.
    clear: float = 0.0

    def record(self) -> dict[str, Any]:
        """Return all but `data` as JSON takes it: what a page in a browser runs."""
        return {key: value for key, value in asdict(replace(self, data={})).items() if key != "data"}


@dataclass(frozen=True)
class Limits:
    """What a device takes: bytes of a storage binding and of a buffer, and texels of a target's side."""

    binding: int
    buffer: int
    side: int

    @property
    def storage(self) -> int:
        """Bytes of a buffer that a pass binds as storage."""
        return min(self.binding, self.buffer)
