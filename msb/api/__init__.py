"""The public verbs that are one module each; `msb` exports them."""
