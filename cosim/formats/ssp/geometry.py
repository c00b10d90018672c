"""Where a drawing of a system puts its parts and wires: kept for tools that draw, unknown to the master."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from .files import Element, children
from .plan import DOWNWARD, Plan, dotted

Attributes = Mapping[str, str]
BOX = ("x1", "y1", "x2", "y2")
ICON = ("rotation", "iconRotation", "iconFlip", "iconFixedAspectRatio")


@dataclass(frozen=True)
class Geometry:
    """The drawing of a system, with the numbers of its file as text.

    Attributes
    ----------
    canvas : Mapping of str to str
        Corners of the canvas, x1, y1, x2 and y2; empty if the file gives none.
    elements : dict of str to Mapping
        Corners and rotations of each part, by its dotted name.
    connectors : dict of str to Mapping
        Place x, y of a connector on its part, from 0 to 1, by the variable's dotted name.
    connections : dict of (str, str) to Mapping
        Points of a wire, pointsX and pointsY, from its output to its input, by their dotted names.
    notes : tuple of Mapping
        Notes on the canvas, with their corners and their text.
    """

    canvas: Attributes = field(default_factory=dict)
    elements: dict[str, Attributes] = field(default_factory=dict)
    connectors: dict[str, Attributes] = field(default_factory=dict)
    connections: dict[tuple[str, str], Attributes] = field(default_factory=dict)
    notes: tuple[Attributes, ...] = ()


class Frame(NamedTuple):
    """Where the canvas of a nested system lies on the outermost one: x' = scale * x + shift."""

    x: tuple[float, float] = (1.0, 0.0)
    y: tuple[float, float] = (1.0, 0.0)

    def to_outermost(self, attributes: Attributes) -> dict[str, str]:
        """Attributes with their coordinates on the outermost canvas; unchanged if it is that one."""
        if self == Frame():
            return dict(attributes)
        return {
            name: self._transformed(text, self.x if "x" in name.lower() else self.y)
            for name, text in attributes.items()
        }

    def _transformed(self, text: str, axis: tuple[float, float]) -> str:
        return " ".join(repr(axis[0] * float(number) + axis[1]) for number in text.split())

    def inner(self, canvas: Attributes, box: Attributes) -> Frame:
        """The frame of a system with this canvas in this box of the outermost canvas."""
        axes = []
        for axis in "xy":
            first, last = (float(canvas[f"{axis}{end}"]) for end in (1, 2))
            left, right = (float(box[f"{axis}{end}"]) for end in (1, 2))
            scale = (right - left) / (last - first)
            axes.append((scale, left - scale * first))
        return Frame(*axes)


def geometry(plan: Plan) -> Geometry:
    """The drawing of a plan.

    A nested system is drawn in its box, unless that or its canvas is missing, flat or rotated. What
    passes the connectors of a system is not drawn.
    """
    outermost = plan.canvases[""]
    drawing = Geometry(
        canvas=_first(outermost, "ssd:SystemGeometry", BOX),
        notes=tuple(
            _attributes(note, (*BOX, "text"))
            for note in children(outermost, "ssd:GraphicalElements", "ssd:Note")
        ),
    )
    _draw(plan, "", Frame(), drawing)
    return drawing


def _draw(plan: Plan, path: str, frame: Frame, drawing: Geometry) -> None:
    """Add what a system contains to the drawing."""
    system = plan.canvases[path]
    for element in children(system, "ssd:Elements", "*"):
        inner = plan.elements[path][element.get("name")]
        corners = frame.to_outermost(_first(element, "ssd:ElementGeometry", BOX))
        icon = _first(element, "ssd:ElementGeometry", ICON)
        if inner in plan.fmus and corners:
            drawing.elements[inner] = corners | icon
        if inner in plan.canvases:
            canvas = _first(plan.canvases[inner], "ssd:SystemGeometry", BOX)
            if _has_area(canvas) and _has_area(corners) and not float(icon.get("rotation", 0.0)):
                _draw(plan, inner, frame.inner(canvas, corners), drawing)
            continue
        for connector in children(element, "ssd:Connectors", "ssd:Connector"):
            if position := _first(connector, "ssd:ConnectorGeometry", ("x", "y")):
                drawing.connectors[dotted((inner, connector.get("name")))] = position
    _draw_connections(plan, path, frame, drawing)


def _draw_connections(plan: Plan, path: str, frame: Frame, drawing: Geometry) -> None:
    """Add the wires of a system to the drawing, each from its output."""
    for connection in children(plan.canvases[path], "ssd:Connections", "ssd:Connection"):
        points = frame.to_outermost(
            _first(connection, "ssd:ConnectionGeometry", ("pointsX", "pointsY"))
        )
        ends = []
        for end in ("start", "end"):
            element, name = connection.get(f"{end}Element"), connection.get(f"{end}Connector")
            ends.append((plan.elements[path][element] if element else path, name))
        if not points or not all(end in plan.variables for end in ends):
            continue
        if plan.connectors[ends[0]].kind in DOWNWARD:
            ends.reverse()
            points = {name: " ".join(reversed(text.split())) for name, text in points.items()}
        source, target = map(dotted, ends)
        drawing.connections[source, target] = points


def _has_area(box: Attributes) -> bool:
    """Whether a box is given and not flat."""
    return bool(box) and all(float(box[f"{axis}1"]) != float(box[f"{axis}2"]) for axis in "xy")


def _first(element: Element, tag: str, names: Sequence[str]) -> dict[str, str]:
    """These attributes of the first child of a name; none if there is no such child."""
    return next((_attributes(child, names) for child in children(element, tag)), {})


def _attributes(element: Element, names: Sequence[str]) -> dict[str, str]:
    return {name: element.get(name) for name in names if element.get(name) is not None}
