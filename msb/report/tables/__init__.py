"""The tables of a report. Each builder turns a `Numbers` object into a `Table`."""
