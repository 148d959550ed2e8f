"""The official export format of Triangle Splatting+; MeshSplatting's exporter is a copy of this exporter.

The format follows trianglesplatting2/triangle-splatting2 at fcde03d: create_ply.py.
"""

from msb.methods.mesh_splatting.official import SUFFIXES, write

__all__ = ["SUFFIXES", "write"]
