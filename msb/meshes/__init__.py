"""Read and write mesh files exactly as stored. Each format is one module and one line in `files`.

docs/meshes.md says what each reader keeps, what each writer writes, and which libraries were tried.
"""

from msb.meshes.files import MESH_SUFFIXES, read_mesh, write_mesh
from msb.meshes.mesh import Mesh

__all__ = ["MESH_SUFFIXES", "Mesh", "read_mesh", "write_mesh"]
