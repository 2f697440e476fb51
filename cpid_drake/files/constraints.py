"""What a dataclass declares of its members, for the files that it is read from.

pydantic checks the declarations when `checked_yaml` reads a file. It takes 0.1 s to import, and
declaring something does not need it.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Annotated, Any, get_args

import numpy as np

from cpid_drake.array import Array

if TYPE_CHECKING:
    from pydantic_core import CoreSchema


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Annotation of a number, text or list, such as `Annotated[float, Limits(gt=0)]`.

    The protocol is that of groups of constraints in `annotated_types`, which pydantic understands.

    Attributes:
        gt, ge, lt, le: the number is greater than, at least, less than, at most.
        min_length, max_length: least and largest number of characters or entries.

    """

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    min_length: int | None = None
    max_length: int | None = None

    __is_annotated_types_grouped_metadata__ = True

    def __iter__(self) -> Iterator[object]:
        """Yield pydantic's own constraints."""
        from pydantic import Field

        given = {name: value for name, value in asdict(self).items() if value is not None}
        yield from Field(**given).metadata

    def __repr__(self) -> str:
        """Return the annotation as it is written, for signatures."""
        given = (f"{k}={v:g}" for k, v in asdict(self).items() if v is not None)
        return f"Limits({', '.join(given)})"


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
        return _schema_of(self._read)

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
        return _schema_of(self._refuse)

    def _refuse(self, value: object) -> object:
        raise ValueError("must be left out")


def _schema_of(read: Callable[[object], object]) -> "CoreSchema":
    """Return pydantic's schema of what a function returns of the value in a file."""
    from pydantic_core import core_schema

    return core_schema.no_info_plain_validator_function(read)


@dataclass(frozen=True)
class FirstUnlessTagged:
    """Annotation of a union of dataclasses: the first, unless a YAML tag names another.

    The others have their tags as `yaml_tag`, like the classes of PyYAML.
    """

    def __get_pydantic_core_schema__(
        self, source: object, handler: Callable[[object], "CoreSchema"]
    ) -> "CoreSchema":
        """Return pydantic's schema of the union; a tagged mapping is `{tag: mapping}`."""
        from pydantic_core import core_schema

        first, *others = get_args(source)
        choices: dict[Any, CoreSchema] = {first.__name__: handler(first)}
        for kind in others:
            tag = kind.yaml_tag
            mapping = core_schema.typed_dict_schema(
                {tag: core_schema.typed_dict_field(handler(kind))}
            )
            choices[tag] = core_schema.no_info_after_validator_function(itemgetter(tag), mapping)

        def tag_of(value: object) -> str:
            keys: Iterable[str] = value if isinstance(value, dict) else ()
            return next((key for key in keys if key.startswith("!")), str(first.__name__))

        return core_schema.tagged_union_schema(choices, tag_of)
