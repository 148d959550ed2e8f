"""A small trainer: the four methods' image formations in PyTorch, optimised on a scene's photographs.

What it leaves behind are files in each method's official layout, so that `msb export` reads them; they are
optimised with the method's own image formation, but not by its official training. `docs/training.md` says
what differs. It runs on a CPU; torch comes with the extra `train`, and nothing in `msb` imports this package.

Per triangle everything is computed in float64 by torch's own differentiation. Per pair of a triangle and a
pixel, of which there are a million, it is done by the hand-derived functions of `pair_functions` and
`composite`: flat arrays, no padding, and memory for what the backward pass needs and no more.
"""
