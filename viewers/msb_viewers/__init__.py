"""Viewers: what is wrong with a mesh, seen. pyvista is loaded when something is drawn, not before.

What is shown is plain data (`model`, `state`, `camera`, `picking`, `fanout`, `detail`); `drawing`, `stage`,
`inset`, `viewer` and `controls` bring it to VTK, `page` to a browser, `figure` to paper.
"""
