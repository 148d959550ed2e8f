"""Engines of other people as renderers of the standard tier: wgpu, three.js in a browser, Blender.

Each stands in the entry-point group `msb.renderers` and keeps to `msb.render.backend.Backend`;
docs/engines.md tells how each is set up and how far it agrees with ours. What an engine needs is imported or
started when a renderer is made, so that asking for the list of renderers costs nothing.
"""
