"""Conversion between YAML text and trees of mappings, lists and values; stricter than YAML."""

import re
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from cpid_drake.errors import InputError


def parse_yaml(data: bytes, where: str, tags: tuple[str, ...] = ()) -> object:
    """Return the tree of a YAML text; a tagged mapping becomes `{tag: mapping}`.

    Args:
        data: the text in UTF-8.
        where: the file's name in error messages.
        tags: the tags that mappings can have.

    Raises:
        InputError: not YAML, an alias, repeated keys or unknown tags.

    """
    with yaml_errors(where):
        return _StrictLoader(data.decode("utf-8-sig"), tags).get_single_data()


@dataclass(frozen=True)
class Tagged:
    """A mapping with a tag, for `format_yaml`."""

    tag: str
    mapping: dict[str, object]


def format_yaml(tree: object) -> str:
    """Return a tree as YAML text; an array becomes a list, a `Tagged` a mapping with its tag."""
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


@contextmanager
def yaml_errors(where: str) -> Iterator[None]:
    """Turn the errors of a YAML reader into an InputError that names the file and the place."""
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
    except (ValueError, LookupError, AttributeError, TypeError) as error:  # from dates and the like
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: a value cannot be read: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error


class _StrictLoader(yaml.SafeLoader):
    """Refuses unknown tags, aliases, and repeated keys, of which other readers use the last."""

    def __init__(self, text: str, tags: tuple[str, ...]) -> None:
        super().__init__(text)
        self._tags = tags

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            line = self.peek_event().start_mark.line + 1
            raise yaml.YAMLError(f"aliases are not read: write the value again (line {line})")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.YAMLError(f"a key must be a word, not a collection (line {line})")
            if key.value in seen:
                raise yaml.YAMLError(f"the key '{key.value}' is given twice (line {line})")
            seen.add(key.value)
        return {str(key): value for key, value in super().construct_mapping(node, deep).items()}

    def construct_tagged(self, tag: str, node: yaml.Node) -> dict[str, Any]:
        line = node.start_mark.line + 1
        if tag not in self._tags:
            known = f"choose from {', '.join(self._tags)}" if self._tags else "there are none here"
            raise yaml.YAMLError(f"unknown tag {tag:.80}; {known} (line {line})")
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError(f"what is tagged {tag} must be a mapping (line {line})")
        return {tag: self.construct_mapping(node, deep=True)}


_StrictLoader.add_multi_constructor("", _StrictLoader.construct_tagged)
# YAML 1.1 reads 1e3 and 1.0e3 as text; YAML 1.2 reads them as numbers, as users expect.
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


class _Dumper(yaml.SafeDumper):
    """Writes arrays and tagged mappings as well, and no aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_array(self, data: np.ndarray) -> yaml.Node:
        return self.represent_sequence("tag:yaml.org,2002:seq", data.tolist(), flow_style=True)

    def represent_tagged(self, data: Tagged) -> yaml.Node:
        return self.represent_mapping(data.tag, data.mapping)


_Dumper.add_representer(np.ndarray, _Dumper.represent_array)
_Dumper.add_representer(Tagged, _Dumper.represent_tagged)
