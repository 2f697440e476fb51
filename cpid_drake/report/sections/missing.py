"""The section that says why other sections are missing."""

from dataclasses import dataclass

from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class Missing(Section):
    """The reason why sections are missing."""

    reason: str
    title = "Not shown"
    template = "pictures.html.j2"
    table = None
    pictures = ()

    @property
    def texts(self) -> list[str]:
        """The reason as a sentence."""
        return [self.reason]
