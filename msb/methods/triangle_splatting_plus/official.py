"""What Triangle Splatting+'s own exporter writes: that of MeshSplatting is a copy of it.

trianglesplatting2/triangle-splatting2 at fcde03d: create_ply.py.
"""

from msb.methods.mesh_splatting.official import SUFFIXES, write

__all__ = ["SUFFIXES", "write"]
