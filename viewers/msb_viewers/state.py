"""The state of the topology viewer: visible layers, selection, isolated component.

This module needs no window.
"""

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

# Each key and its action, as listed in the help of the viewer.
HELP: tuple[tuple[str, str], ...] = (
    ("1 ... 9", "show or hide a layer (or click its row)"),
    ("0", "show or hide all layers"),
    ("Tab", "select the layer for N and P"),
    ("N / P", "go to the next / previous element of this layer"),
    ("click", "select a vertex and show its fans"),
    ("F", "zoom to the selection"),
    ("C", "colours: mesh, components, grey"),
    ("I", "show only the selected component, or all"),
    ("[ / ]", "show only the next larger / smaller component"),
    ("K", "clipping box: drag its handles"),
    ("X", "show layers through the surface"),
    ("L", "show or hide the legend"),
    ("S", "save a screenshot"),
    ("Home", "first view"),
    ("Esc", "clear selection, show all components"),
    ("Q", "close"),
    ("drag", "rotate; with Shift: move; wheel: zoom"),
    ("H", "this help"),
)


@dataclass(eq=False)
class ViewState:
    """The state of the topology viewer."""

    model: ViewModel
    # The kinds of the visible layers.
    visible: set[str] = field(default_factory=set)
    # The active layer, and the last selected element of each layer. The keys N and P step through the active
    # layer.
    active: str = "nonmanifold_edges"
    cursor: dict[str, int] = field(default_factory=dict)
    coloring: Coloring = "own"
    # The only component that is drawn. The index 0 is the largest component, and None draws all components.
    component: int | None = None
    # The selected element: a kind, and an index in its layer.
    element: tuple[str, int] | None = None
    # The selected vertex, whose fans of faces are shown.
    vertex: int | None = None
    help: bool = False
    legend: bool = True
    # Whether layers are drawn over the surface.
    through: bool = False
    # The text of the status line.
    message: str = ""

    @classmethod
    def first(cls, model: ViewModel) -> ViewState:
        """Return the default state for a model."""
        state = cls(model, model.default_layers(), coloring="own" if model.colors else "grey")
        visible = [kind for kind in model.layers if kind in state.visible]
        if visible or state.active not in model.layers:
            state.active = (visible or list(model.layers))[0]
        state.message = "H: help" if not model.notes else model.notes[0]
        state.message += " Key 1 draws them." if SOUP_NOTE in model.notes[:1] else ""
        return state

    @classmethod
    def of(cls, model: ViewModel, options: ViewOptions) -> ViewState:
        """Return the state for the options of the command."""
        state = cls.first(model)
        if options.show:
            state.visible = parse_kinds(model, options.show)
            state.active = next((kind for kind in model.layers if kind in state.visible), state.active)
        if options.colors is not None:
            if options.colors == "own" and model.colors is None:
                raise UsageError("NAME_UNKNOWN", "--colors own: the mesh has no colours")
            state.coloring = options.colors
        if options.component is not None:
            if options.component > len(model.sizes):
                text = f"--component is {options.component}, but the mesh has {len(model.sizes)} components"
                raise UsageError("NAME_UNKNOWN", text)
            state.isolate(options.component - 1)
        if options.at is not None and options.at.isascii() and options.at.isdigit():
            last = len(model.points if model.seams is None else model.seams.number) - 1
            vertex = None if len(options.at) > 12 else model.vertex_of_row(int(options.at))
            if vertex is None:
                raise UsageError("NAME_UNKNOWN", f"--at is {options.at[:12]}, but the last vertex is {last}")
            state.choose_vertex(vertex)
        elif options.at is not None:
            state.choose(*parse_element(model, options.at))
        return state

    def toggle(self, kind: str) -> None:
        """Show or hide a layer. A layer becomes the active layer when it is shown."""
        layer = self.model.layers[kind]
        if kind in self.visible:
            self.visible.discard(kind)
            self.message = f"{layer.style.label}: hidden"
            return
        self.active = kind
        if len(layer) == 0:
            self.message = f"{layer.style.label}: 0"
            return
        self.visible.add(kind)
        self.message = f"{layer.style.label}: {len(layer):,}"

    def toggle_all(self) -> None:
        """If any layer is visible, hide all layers, otherwise show all layers."""
        self.visible = set() if self.visible else {k for k, layer in self.model.layers.items() if len(layer)}
        self.message = "All layers are shown" if self.visible else "All layers are hidden"

    def next_layer(self) -> None:
        """Activate the next layer that has elements."""
        kinds = [kind for kind, layer in self.model.layers.items() if len(layer)]
        if not kinds:
            self.message = "All layers are empty"
            return
        at = kinds.index(self.active) + 1 if self.active in kinds else 0
        self.active = kinds[at % len(kinds)]
        self.message = f"N / P: next / previous of {self.model.layers[self.active].style.label.lower()}"

    def next_coloring(self) -> None:
        """Switch to the next colouring. The colouring "own" is skipped if the mesh has no colours."""
        choices = [c for c in COLORINGS if c != "own" or self.model.colors is not None]
        at = choices.index(self.coloring) + 1 if self.coloring in choices else 0
        self.coloring = choices[at % len(choices)]
        self.message = {"own": "Mesh colours", "grey": "Grey"}.get(self.coloring, "Components by size")

    def toggle_components(self) -> None:
        """Switch between colours of components and colours of the mesh."""
        plain: Coloring = "own" if self.model.colors is not None else "grey"
        self.coloring = "components" if self.coloring != "components" else plain

    def toggle_through(self) -> None:
        """Switch whether layers are drawn over the surface."""
        self.through = not self.through
        self.message = "Layers are drawn over the surface" if self.through else "The surface hides layers"

    def step(self, by: int) -> bool:
        """Select the next (+1) or previous (-1) element of the active layer.

        Return whether this element exists.
        """
        layer = self.model.layers[self.active]
        label = layer.style.label
        rows = self.model.rows(self.active, self.component)
        if len(rows) == 0:
            where = "" if self.component is None else " in this component"
            self.message = f"{label}: 0{where}"
            return False
        if self.active not in self.cursor:
            at = 0 if by > 0 else len(rows) - 1
        else:
            place = self.cursor[self.active]
            at = int(np.searchsorted(rows, place, "right" if by > 0 else "left")) + (0 if by > 0 else -1)
        self.choose(self.active, int(rows[at % len(rows)]))
        return True

    def choose(self, kind: str, place: int) -> None:
        """Select an element by its index in its layer."""
        self.visible.add(kind)
        self.active, self.cursor[kind], self.element, self.vertex = kind, place, (kind, place), None
        self.message = self.describe(kind, place)

    def choose_vertex(self, vertex: int | None) -> None:
        """Select a vertex for the fan inspector. If the vertex is None, no vertex is selected."""
        self.vertex, self.element = vertex, None
        if vertex is None:
            self.message = "No face at this point"

    def describe(self, kind: str, place: int) -> str:
        """Return the status line about an element."""
        layer = self.model.layers[kind]
        number = int(layer.numbers[place])
        vertices = [self.model.row_in_file(vertex) for vertex in layer.vertices[place].tolist()]
        words = [f"{layer.style.label}: {place + 1:,} of {len(layer):,}"]
        if layer.style.of == "edge":
            mesh = self.model.analysis.mesh
            words.append(f"edge {vertices[0]} to {vertices[1]}, {int(mesh.multiplicity[number])} faces")
        elif layer.style.of == "vertex":
            fans = int(self.model.analysis.fans.fans_per_vertex[number])
            words.append(f"vertex {vertices[0]}, {fans} fan{'' if fans == 1 else 's'}")
        else:
            words.append(f"face {number}: {' '.join(map(str, vertices))}")
        component = self.component_of(kind, place)
        if component is not None:
            words.append(self.describe_component(component))
        if not self.model.finite(layer.vertices[place][None])[0]:
            words.append("this position is not finite")
        return " · ".join(words)

    def describe_component(self, component: int) -> str:
        """Return the number and the size of a component as text."""
        count = len(self.model.sizes)
        size = int(self.model.sizes[component])
        return f"component {component + 1:,} of {count:,}, {size:,} face{'' if size == 1 else 's'}"

    def component_of(self, kind: str, place: int) -> int | None:
        """Return the component that contains an element.

        A vertex can be in several components. The function returns the largest of these components.
        """
        layer, model = self.model.layers[kind], self.model
        number = int(layer.numbers[place])
        if layer.style.of == "vertex":
            return self.component_of_vertex(number)
        mesh = model.analysis.mesh
        face = number if layer.style.of == "face" else int(mesh.halfedges_of(number)[0]) // 3
        component = int(model.face_component[face])
        return component if component >= 0 else None

    def component_of_vertex(self, vertex: int) -> int | None:
        """Return the largest component with a face at a vertex."""
        at = self.model.face_component[(self.model.faces == vertex).any(axis=1)]
        at = at[at >= 0]
        return int(at.min()) if len(at) else None

    def isolate_selection(self) -> None:
        """Show only the component of the selected element. If nothing is selected, show only the largest
        component.

        If a component is already isolated, show all components again.
        """
        if self.component is not None:
            self.component, self.message = None, "All components are shown"
            return
        component = None
        if self.element is not None:
            component = self.component_of(*self.element)
        elif self.vertex is not None:
            component = self.component_of_vertex(self.vertex)
        elif len(self.model.sizes):
            component = 0
        self.isolate(component)

    def isolate(self, component: int | None) -> None:
        """Show only one component. The value 0 is the largest component, and None shows all components."""
        if component is None or not 0 <= component < len(self.model.sizes):
            self.component, self.message = None, "This component does not exist"
            return
        self.component = component
        self.message = f"Only {self.describe_component(component)}"

    def isolate_next(self, by: int) -> None:
        """Show only the next smaller (+1) or larger (-1) component."""
        count = len(self.model.sizes)
        start = self.component if self.component is not None else (-1 if by > 0 else count)
        self.isolate((start + by) % count if count else None)

    def release(self) -> None:
        """Clear the selection and show all components."""
        self.element = self.vertex = self.component = None
        self.help = False
        self.message = ""


def parse_kinds(model: ViewModel, texts: Iterable[str]) -> set[str]:
    """Return the layers of texts such as "boundary_edges,duplicate_faces", "all" or "none"."""
    kinds: set[str] = set()
    for word in ",".join(texts).replace(" ", "").split(","):
        if word == "all":
            kinds |= {kind for kind, layer in model.layers.items() if len(layer)}
        elif word in model.layers:
            kinds.add(word)
        elif word not in ("none", ""):
            known = ", ".join(model.layers)
            text = f'--show: the layer "{shorten(word, 40)}" is unknown; use all, none, {known}'
            raise UsageError("NAME_UNKNOWN", text)
    return kinds


def parse_element(model: ViewModel, text: str) -> tuple[str, int]:
    """Return the kind and the index of "KIND:N", the N-th element of a layer. The number N starts at 1."""
    kind, _, number = text.partition(":")
    if kind not in model.layers:
        known = ", ".join(model.layers)
        raise UsageError(
            "NAME_UNKNOWN", f'--at: the layer "{shorten(kind, 40)}" is unknown; use one of {known}'
        )
    count = len(model.layers[kind])
    if not (number.isascii() and number.isdigit() and len(number) < 12 and 1 <= int(number) <= count):
        valid = f"use 1 to {count}" if count else "the layer is empty"
        text = f'--at: "{shorten(number, 20)}" is not an element of {kind}; {valid}'
        raise UsageError("NAME_UNKNOWN", text)
    return kind, int(number) - 1
