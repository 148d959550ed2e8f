"""The topology viewer (`msb view`) and the comparison of renderer tiers (`msb compare`).

`model`, `state`, `camera` and `picking` hold and compute plain data. `drawing`, `stage`, `fans`, `viewer` and
`controls` show the data with VTK. `page` shows the data in a browser, and `figure` makes a figure for print.
`deployment` compares renderer tiers. pyvista is imported only when something is drawn.
"""
