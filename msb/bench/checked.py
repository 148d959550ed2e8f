"""The former name of `msb.bench.validation`."""

from msb.bench.validation import read_json
from msb.bench.validation import validate as checked

__all__ = ["checked", "read_json"]
