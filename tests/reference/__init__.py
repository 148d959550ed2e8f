"""Tests of msb.reference."""
