"""The section with the motion of the base."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from cpid_drake.identification.requests import Evidence
from cpid_drake.report.figures import (
    Picture,
    motion_pictures,
)
from cpid_drake.report.page import Section


@dataclass(frozen=True, eq=False)
class BaseMotion(Section):
    """How the base moved."""

    evidence: Evidence
    title: ClassVar[str] = "Motion of the base"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        if self.pictures:
            return ["As the sensors gave it."]
        return ["No sensor of the base's motion is in the log."]

    @cached_property
    def pictures(self) -> list[Picture]:
        """As far as there are sensors."""
        return motion_pictures(self.evidence.measurements)
