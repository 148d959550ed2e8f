"""Measure the loss of typical porting mistakes: `python -m tools.figures.porting`.

Each run puts one mistake into the WGSL of the dedicated tier. Every affected golden view is drawn and clamped
to [0, 1], without rounding to bytes. It is compared with the official image, at pixels that do not depend on
rounding. The program prints the table of benchmarks/pages/porting.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

from msb.engines.hardware import renderer
from msb.engines.hardware.plan import FRONT_TO_BACK
from msb.engines.hardware.program import STOPS
from msb.registry import METHODS
from tests.reference.golden import exported, golden_views
from tools.figures.losses import EQUAL, psnr

if TYPE_CHECKING:
    from msb.engines.hardware.plan import Plan
    from tests.reference.golden import View

BLENDED = ("two_dts", "triangle_splatting", "mesh_splatting")
BACK_TO_FRONT = (("one", "one-minus-src-alpha"),) * 2
TRANSMITTANCE = ("dst-alpha", "one"), ("zero", "one-minus-src-alpha")
BYTES, HALF = "rgba8unorm", renderer.HALF


@dataclass(frozen=True)
class Mistake:
    """A mistake: the WGSL text that it replaces, and the blend factors, target format and method settings
    that it changes.
    """

    title: str
    texts: Mapping[str, str] = field(default_factory=dict)
    blend: tuple[tuple[str, str], tuple[str, str]] = (FRONT_TO_BACK, FRONT_TO_BACK)
    clear: float = 0.0
    stops: int = 1
    format: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def change(self, plan: Plan) -> Plan:
        """Return the plan with this mistake in it.

        Raises
        ------
        KeyError
            The plan has none of the texts.
        """
        modules = dict(plan.modules)
        for old, new in self.texts.items():
            modules = {name: text.replace(old, new) for name, text in modules.items()}
        if self.texts and modules == plan.modules:
            raise KeyError(self.title)
        form = self.format or plan.format
        return replace(plan, modules=modules, format=form, blend=self.blend, clear=self.clear)


REVERSED = {"let number = order[place];": "let number = order[arguments[0] - 1u - place];"}
_KEY = "bitcast<u32>(found.depth)"
FARTHEST_FIRST = {_KEY: f"0x7f800000u - {_KEY}"}
PLAIN = {
    "^ view.zero": "",
    **{f"^ vec{n}<u32>(view.zero)": "" for n in (2, 3, 4)},
    "return select(q, better,": "return select(q, q,",
    "return select(s, better,": "return select(s, s,",
}
_COLOR = "vec4<f32>(seen.color * seen.alpha, seen.alpha)"
_RGB = "color.rgb + (1.0 - color.a) * view.background"
LINEAR = {
    _COLOR: _COLOR.replace("seen.color", "pow(max(seen.color, vec3<f32>(0.0)), vec3<f32>(2.2))"),
    _RGB: "pow(color.rgb + (1.0 - color.a) * pow(view.background, vec3<f32>(2.2)), vec3<f32>(1.0 / 2.2))",
}
PERSPECTIVE = {
    "let color = face.color.xyz + b1 * face.color1.xyz + b2 * face.color2.xyz;": """
    let far = face.origin.w + vec3<f32>(0.0, face.color1.w, face.color2.w);
    let over = vec3<f32>(1.0 - b1 - b2, b1, b2) / far;
    let p = over / (over.x + over.y + over.z);
    let color = face.color.xyz + p.y * face.color1.xyz + p.z * face.color2.xyz;"""
}
MISTAKES = [
    Mistake("none: as it is", stops=STOPS),
    Mistake("samples never stop"),
    Mistake("target of half floats", format=HALF),
    Mistake(
        "target of half floats that holds T, not 1 - T", format=HALF, blend=TRANSMITTANCE, clear=1.0,
        texts={
            "color /= samples;": "color /= samples; color.a = 1.0 - color.a;",
        },
    ),
    Mistake("target of bytes", format=BYTES),
    Mistake("from back to front, float32", REVERSED, blend=BACK_TO_FRONT),
    Mistake("the same, but of equal depths the lowest number first", FARTHEST_FIRST, blend=BACK_TO_FRONT),
    Mistake("from back to front, half floats", REVERSED, blend=BACK_TO_FRONT, format=HALF),
    Mistake("from back to front, bytes", REVERSED, blend=BACK_TO_FRONT, format=BYTES),
    Mistake("colours blended in linear light", LINEAR),
    Mistake("colours not premultiplied", {_COLOR: "vec4<f32>(seen.color, seen.alpha)"}),
    Mistake("window half a sample off", {"floor(between.place.xy)": "between.place.xy"}),
    Mistake("alpha below 1/255 blended", {
        "if (!(seen.alpha >= MIN_ALPHA))": "if (!(seen.alpha > 0.0))",
        "window_box(&w, coverage[COVERAGE * number + 3u])": "window_box(&w, 0.0)",
        "window_box(&w, rim)": "window_box(&w, 0.0)",
        "let grown = ": "let grown = 1e30; let tighter = ",
        " && e <= face.z.w": "",
        " && e <= face.dual3.w": "",
    }),
    Mistake("alpha up to 1", {
        "const MAX_ALPHA = 0.99;": "const MAX_ALPHA = 1.0;",
        "const MAX_ALPHA = 0.999;": "const MAX_ALPHA = 1.0;",
    }),
    Mistake("colours of SH degree 0", settings={"sh_degree": 0}),
    Mistake("arithmetic left to the compiler", PLAIN),
    Mistake("colours towards the centroid, not (z, z, z)", {
        "select(center, center.zzz, view.broadcast_z == 1u)": "center",
    }),
    Mistake("triangles not half a sample larger", {"let push = div(0.5, far);": "let push = 0.0;"}),
    Mistake("faces below a sample and above 1600 drawn", {
        "if (radius > MAX_RADIUS || radius < 1.0) {": "if (false) {",
        "return !((*w).inradius[2] > -1.0);": "return true;",
    }),
    Mistake("faces drawn from a depth of 0.01 on", {"const NEAREST = 0.2;": "const NEAREST = 0.01;"}),
    Mistake("colours interpolated with perspective", PERSPECTIVE),
    Mistake("one sample a pixel", settings={"supersample": 1}),
    Mistake("no up-scale", settings={"render_up_scale": 1}),
]  # fmt: skip


def drawn(view: View, mistake: Mistake) -> float:
    """Return the PSNR (dB) of a view drawn with a mistake."""
    made = renderer.make_plan

    def plan(*args: Any, **options: Any) -> Plan:
        return mistake.change(made(*args, **options))

    settings = {**view.settings, **mistake.settings}
    red, green, blue = view.background
    asset = exported(view.folder / "checkpoint")
    with (
        patch.object(renderer, "make_plan", plan),
        renderer.HardwareRenderer(asset, settings=settings, stops=mistake.stops) as ours,
    ):
        image = ours.render(view.camera, (red, green, blue)).image
    return psnr(image, view.image, view.stable, quantize=False)


def figures(method: str, mistake: Mistake) -> str:
    """Return median and minimum PSNR over the views of a method, or "-" if the mistake does not apply."""
    found = []
    for view in golden_views(method) if mistake.settings.keys() <= METHODS[method].settings.keys() else ():
        try:
            found.append(drawn(view, mistake))
        except KeyError:
            continue
    if not found:
        return "-"
    middle, least = ("equal" if value >= EQUAL else f"{value:.0f}" for value in (median(found), min(found)))
    return middle if middle == least else f"{middle} ({least})"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", type=int, help="numbers of rows")
    chosen = parser.parse_args().only
    titles = [METHODS[name].title for name in BLENDED]
    sys.stdout.write("| mistake | " + " | ".join(titles) + " |\n" + "|---" * (len(titles) + 1) + "|\n")
    for number, mistake in enumerate(MISTAKES):
        if chosen is None or number in chosen:
            cells = [figures(method, mistake) for method in BLENDED]
            sys.stdout.write(f"| {mistake.title} | " + " | ".join(cells) + " |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
