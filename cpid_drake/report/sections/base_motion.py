"""The section with the motion of the base."""

from cpid_drake.report.figures import motion_pictures
from cpid_drake.report.page import Section
from cpid_drake.sensing.thinning import Excerpt


def base_motion_section(excerpt: Excerpt) -> Section:
    """Return the section with the measured motion of the base."""
    pictures = motion_pictures(excerpt.measurements)
    text = (
        "Measured motion of the base, not filtered. Rotation and displacement are relative to the "
        "first sample."
    )
    if max(excerpt.every.values(), default=1) > 1:
        text += " The log is long: the figures show an even selection of its samples."
    if not pictures:
        text = "The log holds no measurements of the base's motion."
    return Section("Base motion", texts=[text], pictures=pictures)
