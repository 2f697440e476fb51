"""The section with the motion of the base."""

from dataclasses import dataclass
from functools import cached_property

from cpid_drake.identification.requests import Evidence
from cpid_drake.report.figures import (
    Picture,
    motion_pictures,
)
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class BaseMotion(Section):
    """The measured motion of the base."""

    evidence: Evidence
    title = "Base motion"
    template = "pictures.html.j2"
    table = None

    @property
    def texts(self) -> list[str]:
        """An explanation of the pictures."""
        if self.pictures:
            return ["Measured motion of the base, not filtered."]
        return ["The log holds no measurements of the base's motion."]

    @cached_property
    def pictures(self) -> list[Picture]:
        """One picture for each sensor of the base's motion."""
        return motion_pictures(self.evidence.measurements)
