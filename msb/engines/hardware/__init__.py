"""Draws the dedicated tier with an ordinary graphics pipeline: quads are blended, or drawn with a z-buffer.

- `packing`: converts an asset to arrays for the shaders, and a camera to its uniform buffer.
- `plan`: describes the passes and buffers of a frame as plain data. `program` creates this plan for an asset.
- `renderer`: executes a plan with wgpu-py. The browser page executes the same plan from JSON.

The WGSL shared by all methods is in this folder. Each method has its own WGSL and OpenCL files in its
package.
"""
