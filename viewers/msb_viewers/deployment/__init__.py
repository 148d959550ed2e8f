"""The comparison of renderer tiers with photographs, as an image and as a page for a browser.

The module `views` contains the compared cameras, `shots` the images, and `state` the layout. The module
`difference` computes maps of differences. The modules `arrange`, `canvas` and `compose` create an image. The
module `page` creates a web page. No module of this package needs VTK or a display.
"""
