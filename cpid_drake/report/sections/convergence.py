"""The section that shows how the estimate converges."""

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.identification.convergence import Estimates
from cpid_drake.report.figures import convergence_pictures
from cpid_drake.report.page import Section


def convergence_section(estimates: Estimates, truth: InertialParameters | None) -> Section:
    """Return the section with the estimates from growing parts of the log."""
    if all(np.isnan(found.parameters).all() for _, found in estimates):
        return Section("Convergence", texts=["No part of the log determines any parameter."])
    text = (
        "Estimates from the samples up to each time, with their 95 % intervals as a band. The axes "
        "are scaled for the later estimates; earlier ones may lie outside. At times without a "
        "point the samples do not determine the parameter yet."
    )
    dashed = "" if truth is None else " Dashed line: true value."
    pictures = convergence_pictures(estimates, truth)
    return Section("Convergence", texts=[text + dashed], pictures=pictures)
