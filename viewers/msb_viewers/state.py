"""What is switched on, chosen and isolated, and what each key does to it. It needs no window."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from msb.errors import UsageError, shorten
from msb_viewers.model import SOUP_NOTE, ViewModel
from msb_viewers.options import ViewOptions

Coloring = Literal["own", "components", "grey"]
COLORINGS: tuple[Coloring, ...] = ("own", "components", "grey")

# Key -> what it does, as the help shows it.
HELP: tuple[tuple[str, str], ...] = (
    ("1 ... 8", "switch a layer (or click its row)"),
    ("0", "all layers on, or off"),
    ("Tab", "choose the layer to step through"),
    ("N / P", "fly to its next / previous element"),
    ("click", "pick a vertex: its fans drawn apart"),
    ("F", "fly to what is chosen"),
    ("C", "own colours, components, grey"),
    ("I", "show only the chosen component, or all"),
    ("[ / ]", "show only the next larger / smaller one"),
    ("K", "clipping box: drag its handles"),
    ("X", "see layers through the surface"),
    ("L", "legend on or off"),
    ("S", "save a screenshot"),
    ("Home", "the first view"),
    ("Esc", "let go of what is chosen and isolated"),
    ("Q", "close"),
    ("drag", "turn; Shift: move; wheel: zoom"),
    ("H", "this help"),
)


@dataclass(eq=False)
class ViewState:
    """The viewer's switches.

    N and P step through the `active` layer; `cursor` is the place in each layer where they were last.
    `element` is chosen, a kind and a place in its layer; of `vertex` the fans are shown; `component` is the
    only one drawn.
    """

    model: ViewModel
    visible: set[str] = field(default_factory=set)
    active: str = "nonmanifold_edges"
    cursor: dict[str, int] = field(default_factory=dict)
    coloring: Coloring = "own"
    component: int | None = None
    element: tuple[str, int] | None = None
    vertex: int | None = None
    help: bool = False
    legend: bool = True
    through: bool = False
    message: str = ""

    @classmethod
    def first(cls, model: ViewModel) -> ViewState:
        """Return the state a viewer opens with."""
        state = cls(model, model.shown_by_default(), coloring="own" if model.colors else "grey")
        shown = [kind for kind in model.layers if kind in state.visible]
        if shown or state.active not in model.layers:
            state.active = (shown or list(model.layers))[0]
        state.message = "H: help" if not model.notes else model.notes[0]
        state.message += " 1: draw them" if SOUP_NOTE in model.notes[:1] else ""
        return state

    @classmethod
    def of(cls, model: ViewModel, options: ViewOptions) -> ViewState:
        """Return the state that `options` describe."""
        state = cls.first(model)
        if options.show:
            state.visible = parse_kinds(model, options.show)
            state.active = next((kind for kind in model.layers if kind in state.visible), state.active)
        if options.colors is not None:
            if options.colors == "own" and model.colors is None:
                raise UsageError("NAME_UNKNOWN", "--colors own: the mesh has no colours of its own")
            state.coloring = options.colors
        if options.component is not None:
            if options.component > len(model.sizes):
                text = f"--component {options.component}: there are {len(model.sizes)}"
                raise UsageError("NAME_UNKNOWN", text)
            state.isolate(options.component - 1)
        if options.at is not None and options.at.isascii() and options.at.isdigit():
            last = len(model.points) - 1
            if len(options.at) > 12 or int(options.at) > last:
                raise UsageError("NAME_UNKNOWN", f"--at {options.at[:12]}: the last vertex is {last}")
            state.choose_vertex(int(options.at))
        elif options.at is not None:
            state.choose(*parse_element(model, options.at))
        return state

    def toggle(self, kind: str) -> None:
        """Switch a layer; what is switched on becomes the layer to step through."""
        layer = self.model.layers[kind]
        if kind in self.visible:
            self.visible.discard(kind)
            self.message = f"{layer.style.label}: off"
            return
        self.active = kind
        if len(layer) == 0:
            self.message = f"{layer.style.label}: there are none"
            return
        self.visible.add(kind)
        self.message = f"{layer.style.label}: {len(layer):,}"

    def toggle_all(self) -> None:
        """Switch all layers off if any is on, else all on."""
        self.visible = set() if self.visible else {k for k, layer in self.model.layers.items() if len(layer)}
        self.message = "all layers on" if self.visible else "all layers off"

    def next_layer(self) -> None:
        """Make the next layer that has elements the active one."""
        kinds = [kind for kind, layer in self.model.layers.items() if len(layer)]
        if not kinds:
            self.message = "there is nothing to step through"
            return
        at = kinds.index(self.active) + 1 if self.active in kinds else 0
        self.active = kinds[at % len(kinds)]
        self.message = f"N / P step through: {self.model.layers[self.active].style.label}"

    def next_coloring(self) -> None:
        """Go on to the next way to colour the mesh; own colours only where there are some."""
        choices = [c for c in COLORINGS if c != "own" or self.model.colors is not None]
        at = choices.index(self.coloring) + 1 if self.coloring in choices else 0
        self.coloring = choices[at % len(choices)]
        self.message = {"own": "its own colours", "grey": "grey"}.get(self.coloring, "components by size")

    def toggle_components(self) -> None:
        """Colour components by size, or the mesh as it is."""
        plain: Coloring = "own" if self.model.colors is not None else "grey"
        self.coloring = "components" if self.coloring != "components" else plain

    def toggle_through(self) -> None:
        """See layers through the surface, or not."""
        self.through = not self.through
        self.message = "layers are seen through the surface" if self.through else "the surface hides layers"

    def step(self, by: int) -> bool:
        """Choose the next element of the active layer that can be flown to; return whether there is one."""
        layer = self.model.layers[self.active]
        label = layer.style.label
        rows = self.model.rows(self.active, self.component)
        if len(rows) == 0:
            where = "" if self.component is None else " in this component"
            self.message = f"{label}: there are none{where}"
            return False
        if self.active not in self.cursor:
            at = 0 if by > 0 else len(rows) - 1
        else:
            place = self.cursor[self.active]
            at = int(np.searchsorted(rows, place, "right" if by > 0 else "left")) + (0 if by > 0 else -1)
        self.choose(self.active, int(rows[at % len(rows)]))
        return True

    def choose(self, kind: str, place: int) -> None:
        """Choose one element by its place in its layer."""
        self.visible.add(kind)
        self.active, self.cursor[kind], self.element, self.vertex = kind, place, (kind, place), None
        self.message = self.describe(kind, place)

    def choose_vertex(self, vertex: int | None) -> None:
        """Choose a vertex for the fan inspector, or none."""
        self.vertex, self.element = vertex, None
        if vertex is None:
            self.message = "nothing there to pick"

    def describe(self, kind: str, place: int) -> str:
        """Return one line about an element."""
        layer = self.model.layers[kind]
        number, vertices = int(layer.numbers[place]), layer.vertices[place].tolist()
        words = [f"{layer.style.label}: {place + 1:,} of {len(layer):,}"]
        if layer.style.of == "edge":
            mesh = self.model.analysis.mesh
            words.append(f"edge {vertices[0]} to {vertices[1]}, {int(mesh.multiplicity[number])} faces")
        elif layer.style.of == "vertex":
            fans = int(self.model.analysis.fans.fans_per_vertex[number])
            words.append(f"vertex {number}, {fans} fan{'' if fans == 1 else 's'}")
        else:
            words.append(f"face {number}: {' '.join(map(str, vertices))}")
        component = self.component_of(kind, place)
        if component is not None:
            words.append(self.describe_component(component))
        if not self.model.finite(layer.vertices[place][None])[0]:
            words.append("it has no finite position")
        return " · ".join(words)

    def describe_component(self, component: int) -> str:
        """Return a few words about a component."""
        count = len(self.model.sizes)
        size = int(self.model.sizes[component])
        return f"component {component + 1:,} of {count:,}, {size:,} face{'' if size == 1 else 's'}"

    def component_of(self, kind: str, place: int) -> int | None:
        """Return the component an element lies in; of a vertex the largest."""
        layer, model = self.model.layers[kind], self.model
        number = int(layer.numbers[place])
        if layer.style.of == "vertex":
            return self.component_of_vertex(number)
        mesh = model.analysis.mesh
        face = number if layer.style.of == "face" else int(mesh.halfedges_of(number)[0]) // 3
        found = int(model.face_component[face])
        return found if found >= 0 else None

    def component_of_vertex(self, vertex: int) -> int | None:
        """Return the largest component with a face at a vertex."""
        at = self.model.face_component[(self.model.faces == vertex).any(axis=1)]
        at = at[at >= 0]
        return int(at.min()) if len(at) else None

    def isolate_chosen(self) -> None:
        """Show only the component of what is chosen, or all again."""
        if self.component is not None:
            self.component, self.message = None, "all components"
            return
        found = None
        if self.element is not None:
            found = self.component_of(*self.element)
        elif self.vertex is not None:
            found = self.component_of_vertex(self.vertex)
        elif len(self.model.sizes):
            found = 0
        self.isolate(found)

    def isolate(self, component: int | None) -> None:
        """Show only one component, counted by size from 0; None shows all."""
        if component is None or not 0 <= component < len(self.model.sizes):
            self.component, self.message = None, "there is no component to isolate"
            return
        self.component = component
        self.message = f"only {self.describe_component(component)}"

    def isolate_next(self, by: int) -> None:
        """Go on to the next smaller (+1) or larger (-1) component."""
        count = len(self.model.sizes)
        start = self.component if self.component is not None else (-1 if by > 0 else count)
        self.isolate((start + by) % count if count else None)

    def release(self) -> None:
        """Choose nothing, isolate nothing."""
        self.element = self.vertex = self.component = None
        self.help = False
        self.message = ""


def parse_kinds(model: ViewModel, texts: Iterable[str]) -> set[str]:
    """Return the layers named in texts like "boundary_edges,duplicate_faces", "all" or "none"."""
    kinds: set[str] = set()
    for word in ",".join(texts).replace(" ", "").split(","):
        if word == "all":
            kinds |= {kind for kind, layer in model.layers.items() if len(layer)}
        elif word in model.layers:
            kinds.add(word)
        elif word not in ("none", ""):
            text = f'there is no layer "{shorten(word, 40)}"; there are all, none, {", ".join(model.layers)}'
            raise UsageError("NAME_UNKNOWN", text)
    return kinds


def parse_element(model: ViewModel, text: str) -> tuple[str, int]:
    """Return kind and place of "KIND:N", the N-th element of a layer, counted from 1."""
    kind, _, number = text.partition(":")
    if kind not in model.layers:
        known = ", ".join(model.layers)
        raise UsageError("NAME_UNKNOWN", f'--at: there is no layer "{shorten(kind, 40)}"; there are {known}')
    count = len(model.layers[kind])
    if not (number.isascii() and number.isdigit() and len(number) < 12 and 1 <= int(number) <= count):
        which = f"1 to {count}" if count else "none at all"
        text = f'--at: "{shorten(number, 20)}" is no element of {kind}; there are {which}'
        raise UsageError("NAME_UNKNOWN", text)
    return kind, int(number) - 1
