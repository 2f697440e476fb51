"""Limits of a number or of a length, declared where a dataclass declares its members."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Annotation of a number, text or list, such as `Annotated[float, Limits(gt=0)]`.

    pydantic checks it when a file is read; declaring it does not need pydantic. The protocol is
    that of groups of constraints in `annotated_types`, which pydantic understands.

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
