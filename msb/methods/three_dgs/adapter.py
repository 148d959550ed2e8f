"""3DGS: its files are recognised and rejected, because its primitives are Gaussians."""

from typing import NoReturn

from msb.adapters.locate import Place
from msb.adapters.model import Content, Options
from msb.errors import Unsupported
from msb.registry import METHODS

# Items of the tuple that training stores in chkpntN.pth (graphdeco-inria/gaussian-splatting).
_CAPTURED = 12


def recognises(content: Content) -> bool:
    """Return whether `content` is a PLY of Gaussians with three scales, or a training checkpoint."""
    if content.ply_names:
        return {"rot_0", "scale_2"} <= set(content.ply_names)
    value = content.value
    return (
        isinstance(value, tuple)
        and len(value) == 2
        and isinstance(value[0], tuple)
        and len(value[0]) == _CAPTURED
    )


def read(place: Place, content: Content, options: Options) -> NoReturn:
    """Raise UNSUPPORTED_METHOD."""
    why = METHODS["three_dgs"].unsupported["standard"]
    text = f"three_dgs on every tier: {why}, so it cannot be exported"
    raise Unsupported("UNSUPPORTED_METHOD", text, file=place.file)
