"""What SSP 2.0 has more than 1.0, in the words of 1.0: types of FMI 3.0, and arrays as their elements."""

from __future__ import annotations

import re
from collections.abc import Iterator
from copy import deepcopy
from math import prod
from typing import Any, NamedTuple

from lxml.etree import QName

from ...errors import SetupError
from ...system.arrays import CLASSIC_TYPES, element_names
from ...system.declarations import WIDTHS, fits

Element = Any
Shape = tuple[int, ...]
CLOCK = "{http://ssp-standard.org/SSP1/SystemStructureDescription}Clock"

#: A convention of XML Schema: the type that is xs:int, which SSP 1.0 has for every Integer.
XS_INT = "Int32"

#: Derived from what a package may have: as many elements of arrays as it may have connectors and values.
MOST_ELEMENTS = 1_000_000


class TooWide(NamedTuple):
    """A whole number that an Integer of SSP 1.0 cannot have, and the text of its value."""

    element: Element
    text: str


def downgrade_to_1_0(root: Element, name: str) -> list[TooWide]:
    """Rewrite an element of SSP 2.0 as one of 1.0, in place, without what says nothing of the system.

    Parameters
    ----------
    root : Element
        A structure or a parameter set.
    name : str
        The file that it is from, for messages.

    Returns
    -------
    list of TooWide
        Values that an Integer of SSP 1.0 cannot have, which are 0 here; the caller sets them again after validation.

    Raises
    ------
    SetupError
        For arrays of unknown size, connections between arrays of different sizes, and values outside
        the range of their type.
    """
    root.set("version", "1.0")
    inline = [(e, e.getparent()) for e in root.iter("{*}ParameterSet") if e is not root]
    for parameters, parent in inline:  # each has a version of its own
        parent.remove(parameters)
    for extra in list(root.iter("{*}MetaData", "{*}Signature", CLOCK)):
        extra.getparent().remove(extra)
    shapes = _expand_connectors(root, name)
    for connection in list(root.iter("{*}Connection")):
        _expand_connection(connection, shapes, name)
    for parameter in list(root.iter("{*}Parameter")):
        _expand_parameter(parameter, name)
    wide = list(_take_out_wide_numbers(root, name))
    for element in root.iter(*(f"{{*}}{kind}" for kind in CLASSIC_TYPES)):
        tag = QName(element)
        element.tag = QName(tag.namespace, CLASSIC_TYPES[tag.localname])
    for parameters, parent in inline:
        parent.append(parameters)
    return wide


def _expand_connectors(root: Element, name: str) -> dict[tuple[Element, str], Shape]:
    """Put elements in place of the connectors that are arrays; their shapes by owner and name."""
    shapes: dict[tuple[Element, str], Shape] = {}
    count = 0
    for connector in list(root.iter("{*}Connector")):
        shape = _take_shape(connector, name)
        if shape is None:
            continue
        count += prod(shape)
        if count > MOST_ELEMENTS:
            raise SetupError(f"{name}: its arrays have more than {MOST_ELEMENTS} elements")
        shapes[connector.getparent().getparent(), connector.get("name")] = shape
        _replace(
            connector,
            [_copy_with_subscript(connector, subscript) for subscript in element_names("", shape)],
        )
    return shapes


def _expand_connection(
    connection: Element, shapes: dict[tuple[Element, str], Shape], name: str
) -> None:
    """Put connections of elements in place of one of arrays."""
    if not shapes and not {"startIndices", "endIndices"} & {*connection.attrib}:
        return
    subscripts: list[list[str]] = []
    sizes: list[str] = []
    for end in ("start", "end"):
        indices = connection.attrib.pop(f"{end}Indices", "").split()
        shape = shapes.get((_owner(connection, end), connection.get(f"{end}Connector")))
        if indices:
            subscripts.append([f"[{','.join(indices)}]"])
        else:
            subscripts.append([""] if shape is None else element_names("", shape))
        sizes.append(str(() if indices or shape is None else shape))
    if sizes[0] != sizes[1]:
        ends = " and ".join(connection.get(f"{end}Connector") for end in ("start", "end"))
        raise SetupError(
            f"{name}, line {connection.sourceline}: {ends} have the sizes {' and '.join(sizes)}"
        )
    if subscripts == [[""], [""]]:
        return
    copies: list[Element] = []
    for start, end in zip(*subscripts):
        copy = deepcopy(connection)
        copy.set("startConnector", connection.get("startConnector") + start)
        copy.set("endConnector", connection.get("endConnector") + end)
        copies.append(copy)
    _replace(connection, copies)


def _owner(connection: Element, end: str) -> Element | None:
    """The system or the element of it that has the connector at one end."""
    system = connection.getparent().getparent()
    element = connection.get(f"{end}Element")
    if not element:
        return system
    return next((e for e in system.iterfind("{*}Elements/*") if e.get("name") == element), None)


def _expand_parameter(parameter: Element, name: str) -> None:
    """Put values of elements in place of one of an array."""
    shape = _take_shape(parameter, name)
    content = next(parameter.iterchildren("*"), None)
    if content is None:
        return
    listed = [value.get("value", "") for value in content.iterfind("{*}Value")]
    if shape is None:
        if listed:  # one value, which may be written like one of an array
            content.set("value", listed[0])
            content[:] = []
        return
    texts = listed or content.get("value", "").split()
    if len(texts) != prod(shape):
        raise SetupError(
            f"{name}, line {parameter.sourceline}: {parameter.get('name')} has {len(texts)} values "
            f"for {prod(shape)} elements"
        )
    copies: list[Element] = []
    for subscript, text in zip(element_names("", shape), texts):
        copies.append(_copy_with_subscript(parameter, subscript))
        inner = next(copies[-1].iterchildren("*"))
        inner[:] = []
        inner.set("value", text)
    _replace(parameter, copies)


def _take_shape(element: Element, name: str) -> Shape | None:
    """The sizes that Dimension elements give, which are taken out; None if there are none."""
    dimensions = list(element.iterfind("{*}Dimension"))
    for dimension in dimensions:
        if not re.fullmatch(r"\s*\d+\s*", dimension.get("size", "")):
            where = f"{name}, line {element.sourceline}: {element.get('name')}"
            raise SetupError(f"{where}: a Dimension without a size as a number is not supported")
        element.remove(dimension)
    return tuple(int(d.get("size")) for d in dimensions) if dimensions else None


def _copy_with_subscript(element: Element, subscript: str) -> Element:
    copy = deepcopy(element)
    copy.set("name", element.get("name") + subscript)
    return copy


def _replace(element: Element, copies: list[Element]) -> None:
    parent = element.getparent()
    where = parent.index(element)
    parent[where : where + 1] = copies


def _take_out_wide_numbers(root: Element, name: str) -> Iterator[TooWide]:
    """Put 0 in place of whole numbers that are too large for SSP 1.0, which are returned."""
    for element in root.iter(*(f"{{*}}{kind}" for kind in WIDTHS)):
        text = element.get("value", "")
        if not re.fullmatch(r"\s*[+-]?[0-9]{1,20}\s*", text):
            continue
        if not fits(int(text), QName(element).localname):
            where = f"{name}, line {element.sourceline}: {element.getparent().get('name')}"
            raise SetupError(f"{where} = {text} is outside the range of {QName(element).localname}")
        if not fits(int(text), XS_INT):
            element.set("value", "0")
            yield TooWide(element, text)
