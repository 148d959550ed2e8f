"""Read and write mesh files exactly as stored.

Each mesh format has a separate module and one line in `files`.

The page docs/meshes.md lists the data that each reader and writer keeps, and the libraries that we
considered.
"""

from msb.meshes.files import MESH_SUFFIXES, read_mesh, write_mesh
from msb.meshes.mesh import Mesh

__all__ = ["MESH_SUFFIXES", "Mesh", "read_mesh", "write_mesh"]
