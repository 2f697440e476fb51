"""Reads dataclasses from YAML and JSON; their declarations define keys, types and limits.

A dataclass states its limits where it declares its members, with the annotations in `constraints`.
pydantic checks them. This module reads the files, limits their size, and turns pydantic's errors
into messages of one line with the problem, its place and the remedy.
"""

import json
import re
from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import yaml

from cpid_drake.files.dumping import to_tree
from cpid_drake.files.errors import InputError, choose_from

if TYPE_CHECKING:  # pydantic takes 0.1 s to import, and only reading a file needs it
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

Schema = TypeVar("Schema")

LARGEST_FILE = 1_000_000
"""Largest YAML file [bytes]; a scenario has about 3000."""


def load_yaml(schema: type[Schema], file: Path, where: str, whole: str) -> Schema:
    """Read a dataclass from a YAML file; absent keys have their default values.

    Args:
        schema: the dataclass.
        file: the file to read.
        where: the file's name in error messages.
        whole: the file's contents in error messages, such as "a scenario".

    Raises:
        InputError: not YAML, larger than `LARGEST_FILE`, an alias, unknown or repeated keys,
            unknown tags, or values of another type or out of their limits.

    """
    with file.open("rb") as stream:
        data = stream.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise InputError(f"{where}: larger than {LARGEST_FILE / 1e6:g} MB: not {whole}")
    return from_tree(schema, parse_yaml(data, where), where, whole)


def parse_yaml(data: bytes, where: str) -> object:
    """Return the tree of a YAML text in UTF-8; a tagged mapping becomes `{tag: mapping}`.

    Raises:
        InputError: not YAML, an alias, repeated keys, or tags of anything but mappings.

    """
    try:
        return _StrictLoader(data.decode("utf-8-sig")).get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise InputError(f"{where}: not YAML: {place}{error.problem}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError) as error:
        # PyYAML's own conversions raise the last four, for dates and the like.
        raise InputError(f"{where}: not YAML: {error}") from error


class _StrictLoader(yaml.SafeLoader):
    """Refuses aliases, and repeated keys, of which other readers use the last; keeps tags."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise _at(self.current_event, "aliases are not read: write the value again")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _at(key, "a key must be a word, not a collection")
            if key.value in keys:
                raise _at(key, f"the key '{key.value}' is given twice")
            keys.add(key.value)
        return {str(key): value for key, value in super().construct_mapping(node, deep).items()}

    def construct_tagged(self, tag: str, node: yaml.Node) -> dict[str, Any]:
        if not (tag.startswith("!") and isinstance(node, yaml.MappingNode)):
            raise _at(node, f"the tag {tag:.80} is not read here: leave it out")
        return {tag: self.construct_mapping(node, deep=True)}


def _at(place: Any, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)


_StrictLoader.add_multi_constructor("", _StrictLoader.construct_tagged)
# YAML 1.1 reads 1e3 and 1.0e3 as text; YAML 1.2 reads them as numbers, as users expect.
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def load_json(data: bytes, where: str) -> object:
    """Return the tree of a JSON text, for `from_tree`.

    Raises:
        InputError: not JSON, repeated keys, or nested too deeply.

    """

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        names = [name for name, _ in pairs]
        if len(set(names)) < len(names):
            raise ValueError(f"the key {max(names, key=names.count)!r:.60} is given twice")
        return dict(pairs)

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no number of JSON; unknown numbers are null")

    try:
        text = data.decode("utf-8-sig")
        return json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except ValueError as error:  # from JSON, or from the encoding
        raise InputError(f"{where}: not JSON: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error


def from_tree(schema: type[Schema], tree: object, where: str, whole: str) -> Schema:
    """Return a dataclass from nested mappings, lists and values; the arguments are `load_yaml`'s.

    Raises:
        InputError: unknown or missing keys, or values of another type or out of their limits.

    """
    from pydantic import ValidationError

    # In strict mode, pydantic accepts a mapping as a dataclass only from JSON. Dates become text.
    text, kind = json.dumps([tree], default=str), cast(Hashable, schema)
    try:
        [value] = _adapter(kind).validate_json(text)
        return cast(Schema, value)
    except ValidationError as error:
        # A misspelt key is both unknown and missing: report the unknown key.
        order = {_UNKNOWN_KEY: 0, "missing": 2}
        first = min(error.errors(), key=lambda each: order.get(each["type"], 1))
        raise InputError(f"{where}: {_message(first, schema, whole)}") from error


def check_values(value: Any, where: str, whole: str) -> None:
    """Check the values of a dataclass by the same rules as those of a file.

    Raises:
        InputError: for the same reasons as `from_tree`.

    """
    from_tree(type(value), to_tree(value), where, whole)


@cache
def _adapter(schema: Hashable) -> "TypeAdapter[list[Any]]":
    """Return pydantic's validator of a list of one dataclass, which uses the list's settings."""
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    one: Any = list.__class_getitem__(schema)
    return TypeAdapter(one, config=strict)


# -- error messages ------------------------------------------------------------------------------

_UNKNOWN_KEY = "unexpected_keyword_argument"
_UNITS = (
    "; numbers are written without units: lengths in metres, angles in radians, masses in kg, "
    "times in s"
)
_NUMBER_WITH_UNIT = re.compile(r"'\s*[-+]?\.?\d[\d.]*\s*[a-zA-Zµ°'][^']*'")


def _message(error: "ErrorDetails", schema: type, whole: str) -> str:
    """Return a message for an error of pydantic's: the place, the problem, and the remedy."""
    kind, context = error["type"], error.get("ctx", {})
    key, keys = _locate(schema, error["loc"][1:])
    if kind == _UNKNOWN_KEY:
        return f"unknown key '{key:.200}'; {choose_from(error['loc'][-1], keys)}"
    if kind == "union_tag_invalid":
        tags = re.findall(r"!\w+", context["expected_tags"])
        return f"{key}: unknown tag {context['tag']:.80}; {choose_from(context['tag'], tags)}"
    if kind in ("missing", "string_too_short"):
        return f"{key} is missing"
    if isinstance(inner := context.get("error"), InputError):  # of a __post_init__
        return f"{key}: {inner}" if key else str(inner)
    text = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if not text.startswith("must be "):
        return f"{key or whole}: {text}"
    shown = json.dumps(error["input"], ensure_ascii=False).replace('"', "'")
    has_unit = kind in ("float_type", "value_error") and _NUMBER_WITH_UNIT.search(shown)
    text = f"{text.replace('an object', 'a mapping')}, not {shown:.60}"
    return f"{key or whole} {text}{_UNITS if has_unit else ''}"


def _locate(schema: type, place: tuple[int | str, ...]) -> tuple[str, list[str]]:
    """Return the key path of an error of pydantic's, and the keys of the section that it is in."""
    key, keys, kind = "", list[str](), schema
    for part in place:
        choices = get_args(kind) if get_origin(kind) in (Union, UnionType) else [kind]
        chosen = [each for each in choices if part in _names(each)]
        if chosen:  # of a union, pydantic names the choice, then perhaps its tag
            [kind] = chosen
            continue
        key += f"[{part}]" if isinstance(part, int) else f".{part}"
        if sections := [each for each in choices if is_dataclass(each)]:
            keys = [entry.name for entry in fields(sections[0])]
            kind = get_type_hints(sections[0]).get(str(part), object)
        else:
            kind = next((each for each in get_args(kind)[::-1] if each is not Ellipsis), object)
    return key.strip("."), keys


def _names(kind: object) -> tuple[object, ...]:
    return getattr(kind, "__name__", None), getattr(kind, "yaml_tag", None)
