"""The comparison of renderer tiers with photographs, as an image and as a page for a browser.

`views` has the compared cameras, `shots` the images, and `state` the layout. `difference` computes maps of
differences. `arrange`, `canvas` and `compose` create an image, and `page` a web page. No module of this
package needs VTK or a display.
"""
