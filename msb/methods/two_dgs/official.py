"""The official PLY file of 2DGS equals the file of 3DGS, but has two scales instead of three."""

from msb.methods.three_dgs.official import SUFFIXES, write

__all__ = ["SUFFIXES", "write"]
