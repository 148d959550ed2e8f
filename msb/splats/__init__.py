"""Gaussian splats: the values in their file formats, and the Gaussians of an asset.

The modules decode bytes and arrays of untrusted files. Containers (PLY, GLB, ZIP, images) are opened by the
adapters of the methods.
"""
