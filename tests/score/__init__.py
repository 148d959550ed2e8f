"""Tests of `msb score`."""
