"""Decibels as text."""

from msb.metrics.likeness import decibels


def test_decibels_are_rounded_down() -> None:
    values = {34.998: "34.9 dB", 35.0: "35.0 dB", 25.1: "25.1 dB", 32.3: "32.3 dB", 100.0: "100.0 dB"}
    assert [decibels(value) for value in values] == list(values.values())
