"""The values that Ning et al. 2016 print. All other values of the study are computed."""

import numpy as np

from cpid_drake import InertialParameters

PAPER_TARGET = InertialParameters(
    100.0, np.array([0.4330127, 0.0, 0.0]), np.diag([20.0, 30.0, 10.0])
)
"""The true target of Ning et al. 2016, Table 1; the paper's results are for this target only."""

EXCITING = "exciting_motion"
"""The shipped scenario with this target and a motion that moves the base faster."""

PAPER_TABLE_1 = InertialParameters.from_vector(
    [99.897213, 0.434876, 0.001487, -0.000866]
    + [18.962848, 30.018296, 9.706598, -0.279775, -0.09017, -0.075827]
)
"""The identified parameters that Ning et al. 2016 report in Table 1."""

PAPER_TABLE_2 = {
    1: 234.521597,
    2: 98.798019,
    3: 99.015893,
    4: 99.897745,
    5: 99.895927,
    6: 99.897213,
    7: 99.897998,
    8: 99.898010,
    9: 99.897998,
}
"""Decimals of the data, and the identified mass [kg], as Ning et al. 2016 report in Table 2."""

PAPER_FIGURE_7 = {"attitude": 0.0025, "position": 0.0004}
"""Largest relative errors after re-simulation that Ning et al. 2016 report (Fig. 7)."""

PAPER_DIGITS = 6
"""Decimals of the data of Table 1: its mass is that for six decimals in Table 2."""


def is_papers_target(truth: InertialParameters) -> bool:
    """Return whether a target is the paper's, so that the paper's results can be compared."""
    return np.allclose(truth.to_vector(), PAPER_TARGET.to_vector(), rtol=1e-6, atol=1e-6)
