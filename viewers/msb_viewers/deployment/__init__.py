"""The comparison of a model's tiers with its photographs, as an image and as a page for a browser.

`views` has the compared cameras, `shots` the images, and `state` the layout. `difference` computes maps of
differences. `arrange`, `canvas` and `compose` create an image, and `page` a web page. None of them needs VTK
or a display.
"""
