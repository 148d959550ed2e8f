"""A small trainer: the four methods' image formations in PyTorch, optimised on a scene's photographs.

It writes files in each method's official layout, which `msb export` reads. Models are optimised with the
method's image formation, but not by its official training; docs/training.md lists the differences. It runs on
a CPU. The extra `train` installs torch, and nothing in `msb` imports this package.

Values per triangle are float64 and differentiated by torch. There are about a million pairs of a triangle and
a pixel; their values and derivatives are computed by the hand-derived functions of `pair_functions` and
`composite` on flat arrays, and only values that the backward pass needs are stored.
"""
