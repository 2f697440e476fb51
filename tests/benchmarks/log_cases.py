"""The table of spoiled logs."""

import cases_of_columns as columns
import cases_of_truth as truth
import log_spoils as spoil
from log_case import Case

ISSUE = {
    "half_second": Case("issue", "flyer_testbed", r".", options=("--to", "0.5")),
    "planar_9_decimals": Case(
        "issue", "planar_exact", r"not known|determine", columns=spoil.rounded(9)
    ),
    "planar_noise": Case("issue", "planar_flight", r"not known|determine"),
    "short_exact": Case("issue", "arms_exact", r".", options=("--to", "0.3")),
    "rest_only": Case("issue", "arms_servicer", r".", options=("--to", "0.2")),
}

CASES: dict[str, Case] = {
    **ISSUE,
    **columns.UNITS,
    **columns.FRAMES,
    **columns.JOINTS,
    **columns.CLOCKS,
    **truth.MODELS,
    **truth.PAYLOADS,
    **truth.MOMENTA,
    **truth.NOISES,
}
"""All cases by name."""
