"""Result records to tables, figures and pages; the paper's own tables ship here as data."""

from msb.report.paper import paper_row

__all__ = ["paper_row"]
