"""YAML into dataclasses by Drake's reader, and no silence about what it would let pass."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TypeVar, get_args, get_origin

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed

from cpid_drake.errors import InputError

Schema = TypeVar("Schema")


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
        InputError: not YAML, unknown or repeated keys, unknown tags, or values of another type.

    """
    try:
        text = file.read_text(encoding="utf-8-sig")
        loader = _StrictLoader(text, list(dict.fromkeys(_tags(schema))))
        _Structure(where, whole).check(loader.get_single_data(), schema, "")
        return yaml_load_typed(schema=schema, data=text, defaults=schema())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: not YAML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error
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


def _choices(kind: type) -> list[type]:
    """Return the dataclasses that a member of this type can be."""
    return [choice for choice in get_args(kind) or [kind] if is_dataclass(choice)]


def _tags(kind: type) -> Iterator[str]:
    """Yield the tags that a file of this type can have."""
    for choice in _choices(kind)[1:]:
        yield f"!{choice.__name__}"
    for choice in _choices(kind):
        for entry in fields(choice):
            yield from _tags(entry.type)


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
            if key.value in seen:
                line = key.start_mark.line + 1
                raise yaml.YAMLError(f"the key '{key.value}' is given twice (line {line})")
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_tagged(self, tag: str, node: yaml.Node) -> _TaggedMapping:
        line = node.start_mark.line + 1
        if tag not in self._tags:
            known = f"choose from {', '.join(self._tags)}" if self._tags else "there are none here"
            raise yaml.YAMLError(f"unknown tag {tag}; {known} (line {line})")
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
                raise self._error(key, f"must be a mapping, not {value!r:.60}")
            for name, item in value.items():
                self.check(item, get_args(kind)[1], f"{key}.{name}")
        elif kind is int:
            if not isinstance(value, int) or isinstance(value, bool):
                raise self._error(key, f"must be a whole number, not {value!r:.60}")
        elif kind in (float, np.ndarray):
            try:
                fits = (np.asarray(value, dtype=float).ndim > 0) == (kind is np.ndarray)
            except (TypeError, ValueError, OverflowError):
                fits = False
            if not fits:
                what = "a number" if kind is float else "a list of numbers"
                raise self._error(key, f"must be {what}, not {value!r:.60}")

    def _check_section(self, value: object, schema: type, key: str) -> None:
        """Refuse sections that are no mappings, and keys that the schema does not have."""
        if not isinstance(value, dict):
            raise self._error(key, f"must be a mapping, not {value!r:.60}")
        known = {entry.name: entry.type for entry in fields(schema)}
        for name, item in value.items():
            inner = f"{key}.{name}" if key else str(name)
            if name not in known:
                choices = ", ".join(known)
                raise InputError(f"{self._where}: unknown key '{inner}'; choose from {choices}")
            self.check(item, known[name], inner)

    def _error(self, key: str, problem: str) -> InputError:
        return InputError(f"{self._where}: {key or self._whole} {problem}")
