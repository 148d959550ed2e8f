"""Tests of bakes: opaque meshes that look like the native rendering of a model."""
