"""A small trainer. It optimises models on a scene's photographs by four methods' image formation in PyTorch.

It writes files in each method's official layout, which `msb export` reads. Models are optimised with the
method's image formation, but not by its official training; docs/training.md lists the differences. It runs on
a CPU. The extra `train` installs torch, and nothing in `msb` imports this package.

Values per triangle are float64 and differentiated by torch. There are about a million pairs of a triangle and
a pixel. The functions of `pair_functions` and `composite` compute their values and hand-derived derivatives
on flat arrays. Only values that the backward pass needs are stored.
"""
