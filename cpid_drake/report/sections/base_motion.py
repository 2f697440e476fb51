"""The section with the motion of the base."""

from cpid_drake.logs.log import Measurements
from cpid_drake.report.figures import motion_pictures
from cpid_drake.report.page import Section


def base_motion_section(measurements: Measurements) -> Section:
    """Return the section with the measured motion of the base."""
    shown = measurements.thinned()
    pictures = motion_pictures(shown)
    text = (
        "Measured motion of the base, not filtered. Rotation and displacement are relative to the "
        "first sample."
    )
    if any(len(shown[name]) < len(samples) for name, samples in measurements.items()):
        text += " The log is long: the figures show an even selection of its samples."
    if not pictures:
        text = "The log holds no measurements of the base's motion."
    return Section("Base motion", texts=[text], pictures=pictures)
