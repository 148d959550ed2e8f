"""The half-edge structure and the audit built on it. This package takes arrays and knows no files."""

from msb.topology.audit import Audit, audit_arrays

__all__ = ["Audit", "audit_arrays"]
