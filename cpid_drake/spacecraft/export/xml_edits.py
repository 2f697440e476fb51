"""Edits an XML file and leaves every other byte unchanged: comments, order and spelling."""

import re
from dataclasses import dataclass
from textwrap import indent
from xml.parsers.expat import ExpatError, ParserCreate
from xml.sax.saxutils import escape

from cpid_drake.errors import InputError

_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")


def attribute_text(value: str) -> str:
    """Return a value, escaped for use between double quotes."""
    return escape(value, {'"': "&quot;"})


@dataclass(eq=False)
class Element:
    """An XML element: tag, attributes, parent element, and its range of bytes.

    The start tag is data[start:inside], and the content is data[inside:end]. An element without an
    end tag, `<like this/>`, has no content: `end` equals `inside`.
    """

    tag: str
    attributes: dict[str, str]
    parent: "Element | None"
    start: int
    inside: int
    end: int


class XmlEdits:
    """An XML file and the edits to apply to it.

    Attributes:
        elements: all elements in the file's order.

    Raises:
        InputError: it is not well-formed XML, or it declares entities.

    """

    def __init__(self, data: bytes) -> None:
        self.elements: list[Element] = []
        self._data = data
        self._edits: list[tuple[int, int, bytes]] = []
        open_elements: list[Element] = []
        parser = ParserCreate("utf-8")  # as readers of models do, for any declared encoding

        def start(tag: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex
            found = _TAG.match(data, at)
            if not found:
                raise InputError("not XML")
            parent = open_elements[-1] if open_elements else None
            element = Element(tag, attributes, parent, at, found.end(), found.end())
            self.elements.append(element)
            open_elements.append(element)

        def end(_: str) -> None:
            element = open_elements.pop()
            element.end = max(element.inside, parser.CurrentByteIndex)

        def entity(*_: object) -> None:
            raise InputError("it declares XML entities")

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.EntityDeclHandler = entity
        try:
            parser.Parse(data, True)
        except ExpatError as error:
            raise InputError(f"not well-formed XML: {error}") from error

    def text(self, element: Element) -> str:
        """Return the text between an element's tags as written in the file."""
        return self._data[element.inside : element.end].decode("utf-8", "replace")

    def set_text(self, element: Element, text: str) -> None:
        """Replace the content between an element's tags by this text."""
        self._edits.append((element.inside, element.end, escape(text).encode()))

    def set_attribute(self, element: Element, name: str, value: str) -> None:
        """Change the value of an attribute that the element has."""
        tag = self._data[element.start : element.inside]
        found = re.search(rb"""\s%s\s*=\s*("[^"]*"|'[^']*')""" % name.encode(), tag)
        if found:
            first, last = (element.start + k for k in found.span(1))
            self._edits.append((first, last, f'"{attribute_text(value)}"'.encode()))

    def append(self, element: Element, xml: str) -> None:
        """Insert lines of XML at the end of an element's content."""
        if self._data[: element.inside].endswith(b"/>"):
            inner = ">\n" + indent(xml, "  ") + f"</{element.tag}>"
            self._edits.append((element.inside - 2, element.inside, inner.encode()))
            return
        before = self._data[element.inside : element.end]
        margin = before[before.rfind(b"\n") + 1 :]
        if b"\n" in before and not margin.strip():
            at = element.end - len(margin)
            inner = indent(xml, margin.decode() + "  ")
        else:
            at, inner = element.end, "\n" + xml
        self._edits.append((at, at, inner.encode()))

    def result(self) -> bytes:
        """Return the edited file's content."""
        data = self._data
        for first, last, text in sorted(self._edits, reverse=True):
            data = data[:first] + text + data[last:]
        return data
