"""The official file of 2DGS, which is that of 3DGS with two scales."""

from msb.methods.three_dgs.official import SUFFIXES, write

__all__ = ["SUFFIXES", "write"]
