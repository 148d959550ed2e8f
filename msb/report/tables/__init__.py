"""Every table of the report, each made from numbers alone."""
