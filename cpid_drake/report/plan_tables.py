"""Planned motions as tables."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import spearmanr

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.digits import significant
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.page import Table

LEGEND = (
    "σ: Cramér-Rao bound with all errors that the sensors' file and the spacecraft's uncertainty "
    "state, if all else is calibrated. Plausible: if all else has errors of a plausible size. "
    "Scale: the mass, 0.5 m, and the trace of I of the assumed target."
)
"""The explanation of the tables."""


def motion_table(predictions: Mapping[str, Prediction], title: str) -> Table:
    """Return what is expected of motions, one column each, and what a fit found in trials."""
    columns = predictions.values()
    rows = dict[str, Sequence[float]]()
    is_calibrated = all(each.plausible_sigma is each.sigma for each in columns)
    for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)):
        rows[f"σ({name}), {unit}"] = [each.sigma[k] for each in columns]
        if not is_calibrated:
            rows[f"σ({name}), plausible"] = [each.plausible_sigma[k] for each in columns]
    rows["worst σ, % of scale"] = [100 * each.worst for each in columns]
    rows["rotation of the base, deg"] = [np.degrees(each.base_rotation) for each in columns]
    rows["its rate, deg/s"] = [np.degrees(each.base_rate) for each in columns]
    rows["its displacement, m"] = [each.base_displacement for each in columns]
    rows["largest share of a limit"] = [max(each.usage.values()) for each in columns]
    if any(len(each.errors) for each in columns):
        rows["worst error of fits, %"] = [100 * each.realised for each in columns]
        rows["fits that failed"] = [np.isnan(each.errors).any(axis=1).sum() for each in columns]
    cells = [[name, *(_number(value) for value in values)] for name, values in rows.items()]
    return Table(["", *predictions], cells, title, LEGEND)


def rank_correlation(predictions: Mapping[str, Prediction]) -> float:
    """Return Spearman's rank correlation of predicted and realised errors of motions."""
    pairs = np.array([(each.worst, each.realised) for each in predictions.values()])
    return float(spearmanr(pairs[np.isfinite(pairs).all(axis=1)]).statistic)


def _number(value: float) -> str:
    return significant(value, 3) if np.isfinite(value) else "–"
