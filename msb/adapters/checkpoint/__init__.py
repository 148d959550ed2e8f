"""Read files of `torch.save` (.pt, .ckpt) without torch; nothing in them is ever imported or executed.

`docs/checkpoints.md` says what is read and what is refused.
"""

from msb.adapters.checkpoint.reader import read_checkpoint
from msb.adapters.checkpoint.tensors import BFloat16Array

__all__ = ["BFloat16Array", "read_checkpoint"]
