"""The viewers, which show what is wrong with a mesh. pyvista is loaded only when something is drawn.

What is shown is plain data (`model`, `state`, `camera`, `picking`). `drawing`, `stage`, `fans`, `window`,
`viewer` and `controls` bring it to VTK, `page` to a browser, `figure` to paper. `deployment` compares tiers.
"""
