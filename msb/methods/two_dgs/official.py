"""The official file of 2DGS is the file of 3DGS with two scales instead of three."""

from msb.methods.three_dgs.official import SUFFIXES, write

__all__ = ["SUFFIXES", "write"]
