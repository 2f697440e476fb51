"""Conversion of YAML and JSON to dataclasses; their declarations define keys, types and limits.

A dataclass states its limits where it declares its members, with `constraints.Limits` and with the
annotations of this module. pydantic checks them; this module reads the files, limits their size,
and writes error messages of one line with the problem, its place and the remedy.
"""

import json
import re
from collections.abc import Callable, Hashable
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import yaml
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError, choose_from

if TYPE_CHECKING:  # pydantic takes 0.1 s to import, and only reading a file needs it
    from pydantic import TypeAdapter
    from pydantic_core import CoreSchema, ErrorDetails

Schema = TypeVar("Schema")

LARGEST_FILE = 1_000_000
"""Largest YAML file [bytes]; a scenario has about 3000."""


# -- declarations --------------------------------------------------------------------------------


class Numbers:
    """Annotation of an array: finite numbers of this shape, or of any shape if none is given.

    If `unknown` is true, null is allowed for a number that is not known, and becomes NaN.
    """

    def __init__(self, *shape: int, unknown: bool = False) -> None:
        self._shape, self._unknown = shape, unknown

    def __repr__(self) -> str:
        """Return the annotation as it is written, for signatures."""
        words = [*map(str, self._shape), *(["unknown=True"] if self._unknown else [])]
        return f"Numbers({', '.join(words)})"

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> "CoreSchema":
        """Return pydantic's schema of a list that becomes an array."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._read)

    def _read(self, value: object) -> Array:
        try:
            array = np.asarray(value)
            if self._unknown and array.dtype == object:
                array = np.asarray(np.where(array == np.array(None), np.nan, array).tolist())
        except ValueError:  # rows of unequal length
            array = np.array(None)
        is_list = array.ndim > 0 and array.dtype.kind in "iuf"
        if not is_list or (self._shape and array.shape != self._shape):
            shape = "x".join(map(str, self._shape))
            raise ValueError(" ".join(f"must be a list of {shape} numbers".split()))
        if np.isinf(array).any() or (np.isnan(array).any() and not self._unknown):
            raise ValueError("must be finite numbers")
        return array.astype(float)


Vector = Annotated[Array, Numbers(3)]
"""Three finite numbers."""


@dataclass(frozen=True)
class InMemory:
    """Annotation of a member that files do not have. It must have a default."""

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> "CoreSchema":
        """Return pydantic's schema of nothing."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._refuse)

    def _refuse(self, value: object) -> object:
        raise ValueError("must be left out")


@dataclass(frozen=True)
class FirstUnlessTagged:
    """Annotation of a union of dataclasses: the first, unless a YAML tag `!NAME` names another."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: Callable[[object], "CoreSchema"]
    ) -> "CoreSchema":
        """Return pydantic's schema of the union; a tagged mapping is `{tag: mapping}`."""
        from pydantic_core import core_schema

        first, *others = get_args(source)
        choices: dict[Any, CoreSchema] = {first.__name__: handler(first)}
        for kind in others:
            tag = tag_of(kind)
            tagged = core_schema.typed_dict_schema(
                {tag: core_schema.typed_dict_field(handler(kind))}
            )
            choices[tag] = core_schema.no_info_after_validator_function(itemgetter(tag), tagged)

        def choose(value: object) -> str:
            tags = value if isinstance(value, dict) else ()
            return next((tag for tag in tags if tag in choices), str(first.__name__))

        return core_schema.tagged_union_schema(choices, choose)


def tag_of(kind: type) -> str:
    """Return the YAML tag of a dataclass."""
    return f"!{kind.__name__}"


_TAGS = set[str]()


def tagged(kind: type[Schema]) -> type[Schema]:
    """Declare that a dataclass has a tag in YAML; see `FirstUnlessTagged`."""
    _TAGS.add(tag_of(kind))
    return kind


# -- reading -------------------------------------------------------------------------------------


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
        InputError: not YAML, an alias, repeated keys or unknown tags.

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
    """Refuses unknown tags, aliases, and repeated keys, of which other readers use the last."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise _at(self.current_event, "aliases are not read: write the value again")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _at(key, "a key must be a word, not a collection")
            if key.value in seen:
                raise _at(key, f"the key '{key.value}' is given twice")
            seen.add(key.value)
        return {str(key): value for key, value in super().construct_mapping(node, deep).items()}

    def construct_tagged(self, tag: str, node: yaml.Node) -> dict[str, Any]:
        if tag not in _TAGS or not isinstance(node, yaml.MappingNode):
            known = f"the tags of mappings are {', '.join(sorted(_TAGS)) or 'none'}"
            raise _at(node, f"unknown tag {tag:.80}; {known}")
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
        tree: dict[str, object] = {}
        for name, value in pairs:
            if name in tree:
                raise ValueError(f"the key {name!r:.60} is given twice")
            tree[name] = value
        return tree

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

    # In strict mode, pydantic accepts a mapping as a dataclass only from JSON.
    text, kind = json.dumps([tree], default=_plain), cast(Hashable, schema)
    try:
        [value] = _adapter(kind).validate_json(text)
        return cast(Schema, value)
    except ValidationError as error:
        # A misspelt key is both unknown and missing: report the unknown key.
        order = {_UNKNOWN_KEY: 0, "missing": 2}
        found = min(error.errors(), key=lambda each: order.get(each["type"], 1))
        raise InputError(f"{where}: {_problem(found, schema, whole)}") from error


def check_values(value: Any, where: str, whole: str) -> None:
    """Check the values of a dataclass by the same rules as those of a file.

    Raises:
        InputError: for the same reasons as `from_tree`.

    """
    from_tree(type(value), asdict(value), where, whole)


@cache
def _adapter(schema: Hashable) -> "TypeAdapter[list[Any]]":
    """Return pydantic's validator of a list of one dataclass, which uses the list's settings."""
    from pydantic import ConfigDict, TypeAdapter

    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    one: Any = list.__class_getitem__(schema)
    return TypeAdapter(one, config=strict)


def _plain(value: object) -> object:
    """Return a value for JSON: NumPy types become Python types, dates become text."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


# -- writing -------------------------------------------------------------------------------------


def dump_yaml(value: Any) -> str:
    """Return a dataclass as YAML text that `load_yaml` reads."""

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: object) -> bool:
            return True

        def represent_other(self, data: Any) -> yaml.Node:
            if isinstance(data, np.ndarray):
                sequence = "tag:yaml.org,2002:seq"
                return self.represent_sequence(sequence, data.tolist(), flow_style=True)
            if isinstance(data, np.generic):
                return self.represent_data(data.item())
            names = [each.name for each in fields(data)]
            tag = tag_of(type(data))
            tag = tag if tag in _TAGS else "tag:yaml.org,2002:map"
            return self.represent_mapping(tag, {name: getattr(data, name) for name in names})

    Dumper.add_multi_representer(object, Dumper.represent_other)
    return yaml.dump(value, Dumper=Dumper, sort_keys=False, allow_unicode=True)


def nulls(values: ArrayLike) -> Any:
    """Return numbers for a file, in nested lists: None where `values` are not finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values.astype(object), np.array(None)).tolist()


# -- error messages ------------------------------------------------------------------------------


_UNKNOWN_KEY = "unexpected_keyword_argument"
_UNITS = (
    "; numbers are written without units: lengths in metres, angles in radians, masses in kg, "
    "times in s"
)
_NUMBER_WITH_UNIT = re.compile(r"\s*[-+]?\.?\d[\d.]*\s*[a-zA-Zµ°'\"].*")


def _problem(error: "ErrorDetails", schema: type, whole: str) -> str:
    """Return a message for an error of pydantic's: the place, the problem, and the remedy."""
    kind, value, place = error["type"], error["input"], error["loc"][1:]
    key, keys = _locate(schema, place)
    if kind == _UNKNOWN_KEY:
        return f"unknown key '{key:.200}'; {choose_from(place[-1], keys)}"
    if kind in ("missing", "string_too_short"):
        return f"{key} is missing"
    if isinstance(inner := error.get("ctx", {}).get("error"), InputError):  # of a __post_init__
        return f"{key}: {inner}" if key else str(inner)
    text = error["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    text = text.replace("an object", "a mapping")
    if not text.startswith("must "):
        return f"{key or whole}: {text}"
    words = {None: "null", True: "true", False: "false"}
    shown = words[value] if value is None or isinstance(value, bool) else f"{value!r:.60}"
    parts = value if isinstance(value, list) else [value]
    has_unit = any(isinstance(each, str) and _NUMBER_WITH_UNIT.fullmatch(each) for each in parts)
    hint = _UNITS if has_unit and kind in ("float_type", "value_error") else ""
    return f"{key or whole} {text}, not {shown}{hint}"


def _locate(schema: type, place: tuple[int | str, ...]) -> tuple[str, list[str]]:
    """Return the key path of an error of pydantic's, and the keys of the section that it is in."""
    key, keys, kind = "", list[str](), schema
    for part in place:
        is_union = get_origin(kind) in (Union, UnionType)
        choices = [c for c in (get_args(kind) if is_union else [kind]) if is_dataclass(c)]
        chosen = [choice for choice in choices if part in (choice.__name__, tag_of(choice))]
        if chosen:  # of a union, pydantic names the choice, then perhaps its tag
            [kind] = chosen
            continue
        key += f"[{part}]" if isinstance(part, int) else f".{part}"
        if choices:
            keys = [entry.name for entry in fields(choices[0])]
            kind = get_type_hints(choices[0]).get(str(part), object)
        else:
            kind = next((each for each in get_args(kind)[::-1] if each is not Ellipsis), object)
    return key.strip("."), keys
