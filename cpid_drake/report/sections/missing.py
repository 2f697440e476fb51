"""The section that says why other sections are missing."""

from dataclasses import dataclass
from typing import ClassVar

from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class Missing(Section):
    """The reason why sections are missing."""

    reason: str
    title: ClassVar[str] = "Not shown"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None
    pictures: ClassVar[tuple] = ()

    @property
    def texts(self) -> list[str]:
        """The reason as a sentence."""
        return [self.reason]
