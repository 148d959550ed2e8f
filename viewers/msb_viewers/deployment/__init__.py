"""The deployment viewer: what becomes of a model's look on each tier, beside the photographs.

What is shown is plain data (`views`, `shots`, `state`, `difference`), composed into one picture (`arrange`,
`canvas`, `compose`) with neither VTK nor a display. `painter` and `solver` draw beside the window's own
thread; `viewer` is the window, `page` a page.
"""
