"""Tables, charts, findings and pages from benchmark results, with the published tables of the paper."""

from msb.report.paper import paper_row

__all__ = ["paper_row"]
