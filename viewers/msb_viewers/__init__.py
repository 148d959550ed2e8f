"""The topology viewer (`msb view`) and the comparison of renderer tiers (`msb compare`).

The modules `model`, `state`, `camera` and `picking` hold and compute plain data. The modules `drawing`,
`stage`, `fans`, `viewer` and `controls` show the data with VTK. The module `page` shows the data in a
browser, and `figure` makes a figure for print. `deployment` compares renderer tiers. The package imports
pyvista only when something is drawn.
"""
