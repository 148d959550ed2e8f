"""Tests of `msb.bake`, which makes opaque meshes that look like the native rendering of a model."""
