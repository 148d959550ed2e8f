"""Texts that the options of `msb repair` and `msb trial` share; importing them loads no NumPy."""

PLAN_STEPS = (
    "Steps separated by commas: orient, pair, cut, drop, weld, debris, close, dedupe, outward. "
    "Numbers may follow a step: weld:0.01, pair:0.25, debris:10:0, close:8:0.25."
)
