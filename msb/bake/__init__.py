"""Make a plain asset of a model: a mesh that any engine draws, taught by the model's own renderer."""
