"""Writes a map of columns as YAML, with the reasons for its entries as comments."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass

import numpy as np

from cpid_drake.input_files.validation import dump_yaml
from cpid_drake.logs.column_map import ColumnMap

_WIDTH = 100


def column_map_text(
    column_map: ColumnMap, reasons: Mapping[str, Sequence[str]], heading: Sequence[str] = ()
) -> str:
    """Return a map of columns as YAML text that `load_column_map` reads.

    Args:
        column_map: the map; entries with default values are left out.
        reasons: by key of the map, the comments above the entry.
        heading: comments at the beginning.

    """
    lines = [line for text in heading for line in _comment(text)]
    for entry in fields(column_map):
        value = _plain(getattr(column_map, entry.name))
        said = [line for text in reasons.get(entry.name, ()) for line in _comment(text)]
        if value or said:
            lines += ["", *said]
        if value:
            lines.append(dump_yaml({entry.name: value}).rstrip())
    return "\n".join(lines).lstrip("\n") + "\n"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="#   ")


def _plain(value: object) -> object:
    """Return a section as a tree without its defaults."""
    if not is_dataclass(value) or isinstance(value, type):
        return value
    kind: Callable[[], object] = type(value)
    usual, changed = kind(), {}
    for entry in fields(value):
        given, default = getattr(value, entry.name), getattr(usual, entry.name)
        if not np.array_equal(given, default):
            changed[entry.name] = _number(given)
    return changed


def _number(value: object) -> object:
    """Return an array as a list, and a whole number, such as nanoseconds since 1970, as an int."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, float) and value.is_integer() and abs(value) > 1e3:
        return int(value)
    return value
