"""The dedicated tier through an ordinary graphics pipeline: quads, blended by fixed hardware or z-buffered.

- `packing`: an asset as arrays, and the camera record.
- `plan`: the passes and buffers of a frame as plain data; `program` makes them, with their WGSL, of an asset.
- `renderer`: runs that plan with wgpu-py. A page in a browser runs the same plan from JSON.

The WGSL that methods share lies here; a method's own lies in its package, beside its OpenCL.
"""
