"""Help texts shared by `msb repair` and `msb trial`. Importing this module does not load NumPy."""

# The steps of a repair, in the order of docs/repair.md. orient: turn faces so that the winding is consistent.
# pair: at edges of more than two faces, join the flattest pairs and cut the rest. cut: cut edges of more than
# two faces, and vertices where surfaces only touch. drop: remove a small number of faces, so that no edge has
# more than two. weld: merge coincident vertices. debris: remove small components. close: close small holes.
# dedupe: remove repeated faces. outward: turn closed bodies that are inside out.
STEPS = ("orient", "pair", "cut", "drop", "weld", "debris", "close", "dedupe", "outward")
PLAN_STEPS = (
    "Steps separated by commas: orient, pair, cut, drop, weld, debris, close, dedupe, outward. A step may be "
    "followed by numbers: weld:0.01, pair:0.25, debris:10:0, close:8:0.25."
)
