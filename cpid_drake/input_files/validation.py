"""Conversion of YAML and JSON to dataclasses; their declarations define keys, types and limits.

A dataclass states its limits where it declares its members, with `annotated_types` (such as
`Annotated[float, Gt(0)]`) and with the two annotations of this module. pydantic checks them; this
module reads the files, limits their size, and writes error messages of one line with the problem,
its place and the remedy.
"""

import json
import re
from collections.abc import Callable, Hashable
from dataclasses import asdict, fields, is_dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.errors import InputError, choose_from
from cpid_drake.input_files.yaml_text import Tagged, format_yaml, parse_yaml

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

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> "CoreSchema":
        """Return pydantic's schema of a list that becomes an array."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._read)

    def _read(self, value: object) -> NDArray[np.float64]:
        try:
            array = np.asarray(value)
        except ValueError:  # rows of unequal length
            array = np.array(None)
        unknown = np.zeros(array.shape, dtype=bool)
        if self._unknown and array.ndim and array.dtype == object:
            unknown = np.vectorize(lambda item: item is None, otypes=[bool])(array)
            array = np.asarray(np.where(unknown, 0.0, array).tolist())
        is_list = array.ndim > 0 and array.dtype.kind in "iuf"
        if not is_list or (self._shape and array.shape != self._shape):
            shape = "x".join(map(str, self._shape))
            raise ValueError(" ".join(f"must be a list of {shape} numbers".split()))
        if not np.isfinite(array).all():
            raise ValueError("must be finite numbers")
        return np.where(unknown, np.nan, array.astype(float))


class InMemory:
    """Annotation of a member that files do not have. It must have a default."""

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> "CoreSchema":
        """Return pydantic's schema of nothing."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._refuse)

    def _refuse(self, value: object) -> object:
        raise ValueError("must be left out")


def nulls(values: ArrayLike) -> Any:
    """Return numbers for a file, in nested lists: None where `values` are not finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values.astype(object), np.array(None)).tolist()


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
            return next((tag for tag in tags if tag in choices), first.__name__)

        return core_schema.tagged_union_schema(choices, choose)


def tag_of(kind: type) -> str:
    """Return the YAML tag of a dataclass."""
    return f"!{kind.__name__}"


# -- reading and writing -------------------------------------------------------------------------


def load_yaml(
    schema: type[Schema], file: Path, where: str, whole: str, tags: tuple[str, ...] = ()
) -> Schema:
    """Read a dataclass from a YAML file; absent keys have their default values.

    Args:
        schema: the dataclass.
        file: the file to read.
        where: the file's name in error messages.
        whole: the file's contents in error messages, such as "a scenario".
        tags: the YAML tags that the schema knows; see `FirstUnlessTagged`.

    Raises:
        InputError: not YAML, larger than `LARGEST_FILE` or the limits of `yaml_text`, unknown or
            repeated keys, unknown tags, or values of another type or out of their limits.

    """
    with file.open("rb") as stream:
        data = stream.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise InputError(f"{where}: larger than {LARGEST_FILE / 1e6:g} MB: not {whole}")
    return from_tree(schema, parse_yaml(data, where, tags), where, whole)


def load_json(data: bytes, where: str) -> object:
    """Return the tree of a JSON text, for `from_tree`.

    Raises:
        InputError: not JSON, repeated keys, nested too deeply, or a number that is not finite.

    """

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        tree = dict(pairs)
        if len(tree) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{where}: the key {twice!r:.60} is given twice")
        return tree

    def finite(literal: str) -> float:
        if not np.isfinite(float(literal)):
            raise InputError(
                f"{where}: {literal:.60} is not a finite number; unknown numbers are null"
            )
        return float(literal)

    try:
        text = data.decode("utf-8-sig")
        tree = json.loads(text, object_pairs_hook=unique, parse_float=finite, parse_constant=finite)
        json.dumps(tree, ensure_ascii=False).encode()
        return tree
    except UnicodeEncodeError as error:
        half = ascii(error.object[error.start])
        raise InputError(f"{where}: {half} is half of a character, which is not text") from error
    except InputError:
        raise
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
        return value
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


def dump_yaml(value: Any, tags: tuple[str, ...] = ()) -> str:
    """Return a dataclass as YAML text that `load_yaml` reads with the same tags.

    Structures of Drake's with `__fields__`, such as `SimulatorConfig`, are written as mappings.
    """

    def plain(data: Any) -> object:
        if isinstance(data, dict):
            return {name: plain(item) for name, item in data.items()}
        if isinstance(data, list):
            return [plain(item) for item in data]
        entries = fields(data) if is_dataclass(data) else getattr(data, "__fields__", None)
        if entries is None:
            return data.item() if isinstance(data, np.generic) else data
        members = {entry.name: plain(getattr(data, entry.name)) for entry in entries}
        tag = tag_of(type(data))
        return Tagged(tag, members) if tag in tags else members

    return format_yaml(plain(value))


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


# -- error messages ------------------------------------------------------------------------------


_UNKNOWN_KEY = "unexpected_keyword_argument"

_WANTED = {
    "dataclass_type": "a mapping",
    "dict_type": "a mapping",
    "list_type": "a list",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
}
_UNITS = (
    "; numbers are written without units: lengths in metres, angles in radians, masses in kg, "
    "times in s"
)
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_NUMBER_WITH_UNIT = re.compile(r"\s*[-+]?\.?\d[\d.]*\s*[a-zA-Zµ°'\"].*")


def _problem(error: "ErrorDetails", schema: type, whole: str) -> str:
    """Return a message for an error of pydantic's: the place, the problem, and the remedy."""
    kind, value, limits = error["type"], error["input"], error.get("ctx", {})
    place = list(error["loc"][1:])
    if kind not in (_UNKNOWN_KEY, "missing") and isinstance(value, dict) and len(value) == 1:
        place += [key for key in value if key.startswith("!")]
    section, section_type = _section(schema, place[:-1])
    last = place[-1] if place else ""
    if str(last).startswith("!"):
        return f"{section or whole} cannot be tagged {last}"
    key = f"{section}[{last}]" if isinstance(last, int) else f"{section}.{last}".strip(".")
    if kind == _UNKNOWN_KEY:
        choices = choose_from(last, [entry.name for entry in fields(section_type)])
        return f"unknown key '{key:.200}'; {choices}"
    if kind in ("missing", "string_too_short"):
        return f"{key} is missing"
    if isinstance(limits.get("error"), InputError):  # of a dataclass's __post_init__
        return f"{key}: {limits['error']}" if key else str(limits["error"])
    if kind == "value_error":
        wanted = str(limits["error"])
    elif kind == "too_short":
        wanted = f"needs at least {limits['min_length']} entry"
    elif kind == "literal_error":
        wanted = "must be one of " + ", ".join(re.findall("'(.*?)'", limits["expected"]))
    elif limits.keys() & _BOUNDS.keys():
        [(name, bound)] = limits.items()
        number = "a whole number" if isinstance(bound, int) else "a number"
        wanted = f"must be {number} {_BOUNDS[name]} {bound:g}"
    elif kind in _WANTED:
        wanted = f"must be {_WANTED[kind]}"
    else:
        return f"{key or whole}: {error['msg']}"
    hint = _UNITS if kind in ("float_type", "value_error") and _has_unit(value) else ""
    return f"{key or whole} {wanted}, not {_shown(value)}{hint}"


def _section(schema: type, place: list[int | str]) -> tuple[str, type]:
    """Return the key path of an error of pydantic's, and the declared type at this path."""
    key, kind = "", schema
    for part in place:
        choices = _dataclasses(kind)
        if len(choices) > 1:  # a union: pydantic names the choice, then perhaps its tag
            [kind] = [each for each in choices if part in (each.__name__, tag_of(each))]
        elif choices and part != tag_of(choices[0]):
            kind = get_type_hints(choices[0])[str(part)]
            key += f".{part}"
        elif not choices:
            kind = next(each for each in reversed(get_args(kind)) if each is not Ellipsis)
            key += f"[{part}]" if isinstance(part, int) else f".{part}"
    return key.strip("."), (_dataclasses(kind) or [kind])[0]


def _dataclasses(kind: type) -> list[type]:
    """Return the dataclasses of which a value of this type can be."""
    choices = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return [each for each in choices if is_dataclass(each) and isinstance(each, type)]


def _has_unit(value: object) -> bool:
    """Return whether a value is text such as "433 mm", or a list with such text."""
    if isinstance(value, list):
        return any(map(_has_unit, value))
    return isinstance(value, str) and _NUMBER_WITH_UNIT.fullmatch(value) is not None


def _shown(value: object) -> str:
    """Return a value for a message: as YAML, cut to a line."""
    words = {None: "null", True: "true", False: "false"}
    return words[value] if value is None or isinstance(value, bool) else f"{value!r:.60}"
