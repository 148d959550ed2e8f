"""The comparison of a model's tiers with its photographs: a picture, and a page for a browser.

`views` and `shots` are what is compared, `state` how it is shown, `difference` how far images are apart.
`arrange`, `canvas` and `compose` make one picture of it, `page` a page. None of them needs VTK or a display.
"""
