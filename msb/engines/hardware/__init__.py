"""Draws the dedicated tier with an ordinary graphics pipeline.

Each face is a quad, which is blended or drawn with a z-buffer.

- `packing`: converts an asset to arrays for the shaders, and a camera to a uniform buffer.

- `plan`: describes the passes and buffers of a frame as plain data. `program` creates the plan for an asset.

- `device`: executes a plan with wgpu-py, for the class in `renderer`. The browser page reads the same plan
  from JSON.

This folder contains the WGSL that all methods share. The WGSL of a single method is in the package of the
method, next to the OpenCL code.
"""
