"""YAML into dataclasses by Drake's reader, and no silence about what it would let pass."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TypeVar, get_args, get_origin

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed

from cpid_drake.errors import InputError, choose_from

Schema = TypeVar("Schema")

LARGEST_FILE = 1_000_000
"""[bytes]; a scenario has some 3000."""

MOST_VALUES, LONGEST_VALUE, DEEPEST = 20_000, 10_000, 50
"""Values with all aliases written out, characters of one value, and levels of nesting."""

_NUMBER_WITH_UNIT = re.compile(r"\s*[-+]?\.?\d[\d.]*\s*[a-zA-Zµ°'\"].*")


def load_strictly(schema: type[Schema], file: Path, where: str, whole: str) -> Schema:
    """Read a dataclass from a YAML file; keys it leaves out keep their defaults.

    Of a member that is a union of dataclasses, the first is meant unless a tag, `!NAME`, says
    another. A member that may be None can be given as null.

    Args:
        schema: the dataclass; all its members need defaults.
        file: what to read.
        where: how to call the file in error messages.
        whole: how to call what it holds in error messages, such as "a scenario".

    Raises:
        InputError: not YAML, larger than `LARGEST_FILE`, `MOST_VALUES` and the like, unknown or
            repeated keys, unknown tags, or values of another type.

    """
    try:
        with yaml_errors(where):
            with file.open("rb") as stream:
                data = stream.read(LARGEST_FILE + 1)
            if len(data) > LARGEST_FILE:
                raise InputError(f"{where}: larger than {LARGEST_FILE / 1e6:g} MB: not {whole}")
            text = data.decode("utf-8-sig")
            check_size(text, where)
            loader = _StrictLoader(text, list(dict.fromkeys(_tags(schema))))
            _Structure(where, whole).check(loader.get_single_data(), schema, "")
            return yaml_load_typed(schema=schema, data=text, defaults=schema())
    except InputError:
        raise
    except (
        RuntimeError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        AssertionError,
    ) as error:
        # What Drake's reader raises for values that do not fit the schema.
        raise InputError(f"{where}: a value does not fit: {error}") from error


@contextmanager
def yaml_errors(where: str) -> Iterator[None]:
    """Turn what reading YAML raises into an InputError that names the file and the place."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: not YAML: not text in UTF-8") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise InputError(f"{where}: not YAML: {place}{error.problem}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{where}: not YAML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error


def check_size(text: str, where: str) -> None:
    """Refuse what would take a reader long, or much memory: a few aliases can stand for billions.

    Raises:
        InputError: more than `MOST_VALUES` and the like, or an alias within what it stands for.
        yaml.YAMLError: not YAML.

    """
    total, sizes = 0, {}
    open_collections: list[tuple[str | None, int]] = []
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                raise InputError(f"{where}: the alias *{event.anchor} stands for nothing or itself")
            total += sizes[event.anchor]
        elif isinstance(event, yaml.CollectionStartEvent):
            open_collections.append((event.anchor, total))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_collections.pop()
            sizes[anchor] = total - before
        elif isinstance(event, yaml.ScalarEvent):
            total += 1
            sizes[event.anchor] = 1
            if len(event.value) > LONGEST_VALUE:
                raise InputError(f"{where}: a value of {len(event.value)} characters")
        if len(open_collections) > DEEPEST:
            raise InputError(f"{where}: nested too deeply, more than {DEEPEST} levels")
        if total > MOST_VALUES:
            raise InputError(f"{where}: more than {MOST_VALUES} values, aliases written out")


def _members(schema: type) -> dict[str, type]:
    """Return the members of a dataclass, or of one of Drake's own structs, and their types."""
    entries = fields(schema) if is_dataclass(schema) else schema.__fields__
    return {entry.name: entry.type for entry in entries}


def _choices(kind: type) -> list[type]:
    """Return the dataclasses (or structs of Drake's) that a member of this type can be."""
    choices = get_args(kind) or [kind]
    return [each for each in choices if is_dataclass(each) or hasattr(each, "__fields__")]


def _tags(kind: type) -> Iterator[str]:
    """Yield the tags that a file of this type can have."""
    for choice in _choices(kind)[1:]:
        yield f"!{choice.__name__}"
    for choice in _choices(kind):
        for member in _members(choice).values():
            yield from _tags(member)


class _TaggedMapping(dict):
    """A mapping with the YAML tag that it was given."""

    tag: str


class _StrictLoader(yaml.SafeLoader):
    """YAML in which a key that is given twice, or an unknown tag, is an error.

    Plain YAML would take the last of the two keys.
    """

    def __init__(self, text: str, tags: list[str]) -> None:
        super().__init__(text)
        self._tags = tags

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen: set[str] = set()
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.YAMLError(f"a key must be a word, not a collection (line {line})")
            if key.value in seen:
                raise yaml.YAMLError(f"the key '{key.value}' is given twice (line {line})")
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_tagged(self, tag: str, node: yaml.Node) -> _TaggedMapping:
        line = node.start_mark.line + 1
        if tag not in self._tags:
            known = f"choose from {', '.join(self._tags)}" if self._tags else "there are none here"
            raise yaml.YAMLError(f"unknown tag {tag:.80}; {known} (line {line})")
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError(f"what is tagged {tag} must be a mapping (line {line})")
        mapping = _TaggedMapping(self.construct_mapping(node, deep=True))
        mapping.tag = tag
        return mapping


_StrictLoader.add_multi_constructor("", _StrictLoader.construct_tagged)


class _Structure:
    """Whether what was read has the structure of a schema; see `load_strictly` for the names."""

    def __init__(self, where: str, whole: str) -> None:
        self._where, self._whole = where, whole

    def check(self, value: object, kind: type, key: str) -> None:
        """Refuse a tag, a section, a mapping or numbers that are not of this kind."""
        if type(None) in get_args(kind):
            if value is None:
                return
            kinds = [choice for choice in get_args(kind) if choice is not type(None)]
            kind = kinds[0] if len(kinds) == 1 else kind
        sections = _choices(kind)
        if isinstance(value, _TaggedMapping):
            sections = [choice for choice in sections[1:] if value.tag == f"!{choice.__name__}"]
            if not sections:
                raise self._error(key, f"cannot be tagged {value.tag}")
        if sections:
            self._check_section(value, sections[0], key)
        elif get_origin(kind) is dict:
            if not isinstance(value, dict):
                raise self._error(key, f"must be a mapping, not {_shown(value)}")
            for name, item in value.items():
                self.check(item, get_args(kind)[1], f"{key}.{name}")
        elif get_origin(kind) is list:
            if not isinstance(value, list):
                raise self._error(key, f"must be a list, not {_shown(value)}")
            for k, item in enumerate(value):
                self.check(item, get_args(kind)[0], f"{key}[{k}]")
        elif kind in _WANTED and not _fits(value, kind):
            hint = _HINT if kind in (float, np.ndarray) and _has_unit(value) else ""
            raise self._error(key, f"must be {_WANTED[kind]}, not {_shown(value)}{hint}")

    def _check_section(self, value: object, schema: type, key: str) -> None:
        """Refuse sections that are no mappings, and keys that the schema does not have."""
        if not isinstance(value, dict):
            raise self._error(key, f"must be a mapping, not {_shown(value)}")
        known = _members(schema)
        for name, item in value.items():
            inner = f"{key}.{name}" if key else str(name)
            if name not in known:
                choices = choose_from(name, known)
                raise InputError(f"{self._where}: unknown key '{inner:.200}'; {choices}")
            self.check(item, known[name], inner)

    def _error(self, key: str, problem: str) -> InputError:
        return InputError(f"{self._where}: {key or self._whole} {problem}")


_WANTED = {
    int: "a whole number",
    float: "a number",
    np.ndarray: "a list of numbers",
    str: "text",
    bool: "true or false",
}

_HINT = (
    "; numbers are written without units: lengths in metres, angles in radians, masses in kg, "
    "times in s"
)


def _fits(value: object, kind: type) -> bool:
    """Whether a value is of one of the simple kinds; numbers may be text, as YAML 1.1 reads 1e3."""
    if kind in (float, np.ndarray):
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            return False
        is_one = array.ndim == 0 and not isinstance(value, bool | None)
        return is_one if kind is float else array.ndim > 0
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _has_unit(value: object) -> bool:
    """Whether it is text such as "433 mm", or a list with some in it."""
    if isinstance(value, list):
        return any(map(_has_unit, value))
    return isinstance(value, str) and _NUMBER_WITH_UNIT.fullmatch(value) is not None


def _shown(value: object) -> str:
    """Return a value for a message, as YAML says it and cut to a line."""
    words = {None: "null", True: "true", False: "false"}
    return words[value] if value is None or isinstance(value, bool) else f"{value!r:.60}"
