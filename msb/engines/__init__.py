"""Renderers that use other engines for the standard tier: wgpu, three.js in a browser, Blender.

The renderers are entry points of the group `msb.renderers` and implement `msb.render.backend.Backend`. The
page docs/engines.md explains how to set up each engine, and how closely its images match our renderer. An
engine is imported and started only when its renderer is created, so listing the renderers is fast.
"""
