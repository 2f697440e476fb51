"""Edits of XML: what was asked for changes, and not one byte more."""

import pytest

from cpid_drake import InputError
from cpid_drake.spacecraft.export.xml_edits import XmlEdits

ODD = """\ufeff<?xml version="1.0"?>\r
<!-- <b name="not me"/> é -->\r
<a x='1 > "0"'>\r
  <![CDATA[<b/>]]>\r
  <b  name = 'one>' /><b name="&quot;two&quot;">text &amp; <c/></b>\r
</a>\r
"""


def find(edits, tag, name=None):
    (found,) = (e for e in edits.elements if e.tag == tag and e.attributes.get("name") == name)
    return found


def test_elements_are_where_they_are():
    edits = XmlEdits(ODD.encode())
    assert [element.tag for element in edits.elements] == ["a", "b", "b", "c"]
    assert find(edits, "a").attributes == {"x": '1 > "0"'}
    assert find(edits, "c").parent is find(edits, "b", '"two"')
    assert edits.text(find(edits, "b", '"two"')) == "text &amp; <c/>"
    assert edits.text(find(edits, "b", "one>")) == ""
    assert edits.result() == ODD.encode()


@pytest.mark.parametrize(
    ("tag", "name", "before", "after"),
    [
        ("a", None, "</b>\r\n</a>", "</b>\r\n  <n/>\n</a>"),
        ("b", "one>", "'one>' />", "'one>' >\n  <n/>\n</b>"),
        ("b", '"two"', "<c/></b>", "<c/>\n<n/>\n</b>"),
        ("c", None, "<c/>", "<c>\n  <n/>\n</c>"),
    ],
)
def test_what_is_appended_is_the_last_in_its_element(tag, name, before, after):
    edits = XmlEdits(ODD.encode())
    edits.append(find(edits, tag, name), "<n/>\n")
    assert edits.result().decode() == ODD.replace(before, after)
    again = XmlEdits(edits.result())
    (new,) = (element for element in again.elements if element.tag == "n")
    assert (new.parent.tag, new.parent.attributes.get("name")) == (tag, name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not well-formed XML: no element found"),
        ("<a>", "not well-formed XML: no element found"),
        ("<a></b>", "not well-formed XML: mismatched tag"),
        ("<a b='1' b='2'/>", "not well-formed XML: duplicate attribute"),
        ("<!DOCTYPE a [<!ENTITY e 'x'>]><a>&e;</a>", "it declares XML entities"),
    ],
)
def test_what_no_edit_can_be_trusted_with_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        XmlEdits(text.encode())
