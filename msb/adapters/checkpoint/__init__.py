"""Read files of `torch.save` (.pt, .ckpt) without torch, and without importing or executing anything in them.

docs/checkpoints.md lists the supported and the rejected contents.
"""

from msb.adapters.checkpoint.reader import read_checkpoint
from msb.adapters.checkpoint.tensors import BFloat16Array

__all__ = ["BFloat16Array", "read_checkpoint"]
