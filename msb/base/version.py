"""The version of msb. No other file contains the version number."""

__version__ = "0.2.0"
