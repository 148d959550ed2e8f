"""Half-edge structure and audit of triangle meshes given as arrays. This package reads no files."""

from msb.topology.audit import Audit, audit_arrays

__all__ = ["Audit", "audit_arrays"]
