"""XML of model files, with the place of every element in the text, and changed copies of the text.

Drake's reader accepts "--" and any bytes in comments, and a declaration that follows blanks or
names another encoding; they are left out here.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from cpid_drake.files.errors import InputError

_LEFT_OUT = re.compile(rb"\A(\xef\xbb\xbf)?\s*<\?xml.*?\?>|<!--.*?-->", re.S)
_START_TAG = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>")


@dataclass(frozen=True, eq=False)
class Place:
    """Where an element stands in the text: its line, and the bytes of its first tag and of all."""

    line: int
    start: int
    head: int
    stop: int


@dataclass(frozen=True, eq=False)
class XmlText:
    """The text of an XML file and its elements, outer before inner.

    Attributes:
        data: the text without comments.
        places: the place of each element; names keep their prefixes, as in drake:joint.

    """

    data: bytes
    places: Mapping[Element, Place]

    @property
    def root(self) -> Element:
        """The outermost element."""
        return next(iter(self.places))

    def changed(
        self, whole: Mapping[Element, str], heads: Mapping[Element, Mapping[str, str]]
    ) -> bytes:
        """Return the text with other elements, and other attributes, in place of some.

        The lines of all others remain.

        Args:
            whole: the new text of elements, with all inside of them; empty to leave them out.
            heads: all attributes of elements whose inside remains.

        """
        text, end = bytearray(), 0
        for element, place in self.places.items():
            if place.start < end or not (element in whole or element in heads):
                continue
            text += self.data[end : place.start]
            if element in whole:
                end, new = place.stop, whole[element].encode()
            else:
                end = place.head
                entries = (f" {key}={quoteattr(value)}" for key, value in heads[element].items())
                close = "/>" if self.data[:end].endswith(b"/>") else ">"
                new = f"<{element.tag}{''.join(entries)}{close}".encode()
            text += new + b"\n" * (self.data.count(b"\n", place.start, end) - new.count(b"\n"))
        return bytes(text + self.data[end:])


def read_xml(file: Path, where: str) -> XmlText:
    """Return the elements of an XML file.

    Raises:
        InputError: it is empty or not XML, or it has entities or xacro's macros; the message begins
            with `where`.

    """
    data = _LEFT_OUT.sub(lambda match: b"\n" * match[0].count(b"\n"), file.read_bytes())
    if not data.strip():
        raise InputError(f"{where}: the file is empty")
    if template := re.search(rb"<xacro:|\$\{", data):
        number = data.count(b"\n", 0, template.start()) + 1
        raise InputError(f"{where}: line {number}: this file is a xacro template: run xacro first")
    if entity := re.search(rb"<!ENTITY\s+(\S+)", data):
        name = entity[1].decode(errors="replace")
        raise InputError(f"{where}: the entity &{name}; would not be read; write its text")
    places, parser, around = dict[Element, Place](), expat.ParserCreate(), list[Element]()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        element, first = Element(tag, attributes), parser.CurrentByteIndex
        head = _START_TAG.match(data, first)
        end = head.end() if head else first
        line = parser.CurrentLineNumber + data.count(b"\n", first, end)
        if around:
            around[-1].append(element)
        around.append(element)
        places[element] = Place(line, first, end, end)

    def stop(_: str) -> None:
        element = around.pop()
        place = places[element]
        if data[place.head - 2 : place.head] != b"/>":
            end = data.find(b">", parser.CurrentByteIndex) + 1
            places[element] = Place(place.line, place.start, place.head, end)

    def text(content: str) -> None:
        if len(around[-1]):
            inner = around[-1][-1]
            inner.tail = (inner.tail or "") + content
        else:
            around[-1].text = (around[-1].text or "") + content

    parser.StartElementHandler, parser.EndElementHandler = start, stop
    parser.CharacterDataHandler = text
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(
            f"{where}: line {error.lineno}, column {error.offset + 1}: not XML: "
            f"{expat.errors.messages[error.code]}"
        ) from error
    return XmlText(data, places)
