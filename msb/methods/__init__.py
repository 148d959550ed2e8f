"""Our methods, a folder each; `msb.registry` finds them and those that installed packages bring."""
