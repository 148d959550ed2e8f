"""The dedicated tier through an ordinary graphics pipeline: quads in depth order, blended by fixed hardware.

- `packing`: an asset as arrays, and the camera record.
- `program`: WGSL put together, and the passes and buffers of a frame as plain data.
- `renderer`: runs that plan with wgpu-py. A page in a browser runs the same plan from JSON.

The WGSL that methods share lies here; a method's own lies in its package, beside its OpenCL.
"""
