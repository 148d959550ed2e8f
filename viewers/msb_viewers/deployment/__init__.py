"""The comparison of a model's tiers with its photographs, as an image and as a page for a browser.

`views` and `shots` are the compared cameras and images, `state` is the layout, and `difference` computes maps
of differences. `arrange`, `canvas` and `compose` create an image, and `page` a web page. None of them needs
VTK or a display.
"""
