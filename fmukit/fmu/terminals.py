"""terminalsAndIcons: the shaft ends of a model, and its drawing as an icon.

The format is that of FMI 3.0, which FMI 2.0.4 allows. A model names its shaft ends in
`FLANGES = {"flange": ("tau", "w", "phi")}`: torque and speed, which make a power, and the angle
where it has one.
"""

import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..declare.interface import Interface
from .load import neighbour_file

TERMINALS_FOLDER = "terminalsAndIcons"
#: Width of the icon in pixels; a convention of this kit.
ICON_WIDTH = 256
MEMBERS = {"tau": "N.m", "w": "rad/s", "phi": "rad"}


def files_of_terminals(interface: Interface) -> dict[str, bytes]:
    """The files of the folder by their path in the FMU; none for a model without any."""
    icon, ends = drawing_without_text(interface), flanges(interface)
    if not icon and not ends:
        return {}
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    if icon:
        _, width, height = icon
        corners = {"x1": "0", "y1": "0", "x2": f"{width:g}", "y2": f"{height:g}"}
        graphics = SubElement(root, "GraphicalRepresentation")
        SubElement(graphics, "CoordinateSystem", corners, suggestedScalingFactorTo_mm="0.1")
        SubElement(graphics, "Icon", corners)
    terminals = SubElement(root, "Terminals") if ends else root
    for name, members in ends.items():
        terminal = SubElement(terminals, "Terminal", name=name, matchingRule="bus")
        for member, variable in members.items():
            SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=variable,
                memberName=member,
                variableKind="signal",
            )
    ElementTree.indent(root)
    files = {"terminalsAndIcons.xml": ElementTree.tostring(root, "UTF-8", xml_declaration=True)}
    if icon:
        files |= {"icon.svg": icon[0].encode(), "icon.png": icon_png(icon[0])}
    return {f"{TERMINALS_FOLDER}/{name}": content for name, content in files.items()}


def flanges(interface: Interface) -> dict[str, dict[str, str]]:
    """The variables of each shaft end by member; raises ValueError for one that is no shaft end."""
    terminals = {}
    for name, variables in interface.model.FLANGES.items():
        context = f"FLANGES[{name!r}]"
        if len(variables) not in (2, 3):
            raise ValueError(f"{context} must name torque, speed and, if there is one, the angle")
        for (member, unit), variable in zip(MEMBERS.items(), variables):
            port = interface.by_name.get(variable)
            if port is None or port.causality not in ("input", "output"):
                raise ValueError(f"{context}: {variable!r} is neither an input nor an output")
            if port.unit != unit:
                raise ValueError(f"{context}: {variable} [{port.unit}] cannot be {member} [{unit}]")
        torque, speed = (interface.by_name[variable].causality for variable in variables[:2])
        if torque == speed:
            raise ValueError(f"{context}: one of torque and speed must be an input, one an output")
        terminals[name] = dict(zip(MEMBERS, variables))
    return terminals


def drawing_without_text(interface: Interface) -> tuple[str, float, float] | None:
    """The drawing beside a model without its letters, and its width and height."""
    path = neighbour_file(interface.model, "drawing.svg")
    if path is None:
        return None
    text = re.sub(r"<text\b.*?</text>\n?", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    _, _, width, height = ElementTree.fromstring(text).attrib["viewBox"].split()
    return text, float(width), float(height)


def icon_png(svg: str) -> bytes:
    """A picture as PNG, some pixels wide; the same bytes on every machine, for it has no letters."""
    import resvg_py

    return bytes(resvg_py.svg_to_bytes(svg_string=svg, width=ICON_WIDTH, skip_system_fonts=True))
