"""Gaussian splats: the values in their file formats, and the Gaussians of an asset.

The modules of this package decode bytes and arrays of untrusted files. The adapters (readers of a method's
files) open the containers PLY, GLB, ZIP and images.
"""
