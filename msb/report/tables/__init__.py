"""The tables of a report. Each function in this package converts a `Numbers` object to a `Table`."""
