"""Dataclasses as trees of mappings, lists and plain values, and as YAML text of such a tree."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike

from cpid_drake.files.constraints import InMemory


def to_tree(value: Any) -> Any:
    """Return the tree of a dataclass, which `checked_yaml.from_tree` reads without loss.

    Members that are `InMemory` are left out. NaN in arrays is None. A dataclass with a `yaml_tag`
    is `{tag: mapping}`.
    """
    if is_dataclass(value):
        kept = [entry.name for entry in fields(value) if not _is_in_memory(entry.type)]
        tree = {name: to_tree(getattr(value, name)) for name in kept}
        return {value.yaml_tag: tree} if hasattr(value, "yaml_tag") else tree
    if isinstance(value, Mapping):
        return {key: to_tree(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_tree(item) for item in value]
    if isinstance(value, np.ndarray):
        return nulls(value)
    return value.item() if isinstance(value, np.generic) else value


def nulls(values: ArrayLike) -> Any:
    """Return numbers for a file, in nested lists: None where `values` are not finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values.astype(object), np.array(None)).tolist()


def dump_yaml(value: Any) -> str:
    """Return a dataclass as YAML text that `checked_yaml.load_yaml` reads."""
    return yaml.dump(to_tree(value), Dumper=_Dumper, sort_keys=False, allow_unicode=True)


class _Dumper(yaml.SafeDumper):
    """Writes tags, lists of plain values in one line, and equal values each time."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_tree(self, data: dict[str, Any]) -> yaml.Node:
        tag = next(iter(data), "")
        if tag.startswith("!"):
            return self.represent_mapping(tag, data[tag])
        return self.represent_dict(data)

    def represent_entries(self, data: list[Any]) -> yaml.Node:
        is_plain = not any(isinstance(entry, dict) for entry in data)
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=is_plain)


_Dumper.add_representer(dict, _Dumper.represent_tree)
_Dumper.add_representer(list, _Dumper.represent_entries)


def _is_in_memory(kind: object) -> bool:
    return any(isinstance(note, InMemory) for note in getattr(kind, "__metadata__", ()))
