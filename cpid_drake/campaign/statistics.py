"""What the trials of a campaign say, from one pass over its files; memory does not grow with them.

Errors are relative to the scale of the parameters: the true mass, 0.5 m, and the trace of I.
"""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from scipy.special import betaincinv, chdtri

from cpid_drake.array import Array
from cpid_drake.campaign import store
from cpid_drake.campaign.campaign_schema import Axis, CampaignPlan
from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale

CONFIDENCE = 0.95
"""Probability with which a verdict on a requirement, and an interval of a share, is right."""

WRONG_PROBABILITY = 1e-3
"""Probability of an error as large as it is, by the estimate's own covariance, below which the
estimate is wrong: a failed check of such an estimate failed rightly."""

BINS = 8
"""Number of parts of an axis in which errors are compared."""

WORST = 5
"""Number of the worst trials of each estimator that are shown."""


@dataclass
class Worst:
    """A trial with a large error: its number, error, error squared over covariance, and checks."""

    trial: int
    error: float
    nees: float
    failed_checks: str


@dataclass
class Tally:
    """Sums over the trials of one estimator, in a point of the grids or in a part of an axis.

    Attributes:
        trials, failed: number of trials, and of those without an estimate.
        problem: the reason of one failure.
        known, error, square, inside: (10,) for each parameter: the number of estimates, the sums of
            their errors and of their squares, and the number of intervals with the truth.
        bounded, ratio: (10,) number of estimates with a bound, and sum of (error / bound)².
        beside: (10,) sum of the squares of the errors of estimates with a bound.
        scaled: sum of the squares of the largest error relative to its scale.
        bound: (10,) sum of the squares of the bounds relative to the scale.
        nees, freedom: sum of the squared errors in units of the covariance, and what it should be.
        verdicts: number of estimates by (checks passed, estimate right).
        checks: number of failures by (name of the check, estimate right).
        met: number of trials that meet a requirement, by its name.
        seconds: time of the processor for the estimates [s].

    """

    trials: int = 0
    failed: int = 0
    problem: str = ""
    counted: Array = field(default_factory=lambda: np.zeros(10))
    error: Array = field(default_factory=lambda: np.zeros(10))
    square: Array = field(default_factory=lambda: np.zeros(10))
    inside: Array = field(default_factory=lambda: np.zeros(10))
    bounded: Array = field(default_factory=lambda: np.zeros(10))
    ratio: Array = field(default_factory=lambda: np.zeros(10))
    beside: Array = field(default_factory=lambda: np.zeros(10))
    bound: Array = field(default_factory=lambda: np.zeros(10))
    scaled: float = 0.0
    nees: float = 0.0
    freedom: int = 0
    verdicts: Counter[tuple[bool, bool]] = field(default_factory=Counter)
    checks: Counter[tuple[str, bool]] = field(default_factory=Counter)
    met: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0

    @property
    def good(self) -> int:
        """Number of estimates."""
        return self.trials - self.failed

    def rms(self) -> Array:
        """Return the RMS errors (10,) relative to the scale."""
        return _root(self.square, self.counted)

    def beside_bound(self) -> tuple[Array, Array]:
        """Return the RMS errors (10,) of the trials with a bound, and the RMS of the bounds.

        Without any, the errors are those of all trials, and the bounds NaN.
        """
        error = _root(self.beside, self.bounded) if self.bounded.any() else self.rms()
        return error, _root(self.bound, self.bounded)

    def over_bound(self) -> Array:
        """Return the RMS (10,) of error over bound."""
        return _root(self.ratio, self.bounded)

    def nees_band(self) -> tuple[float, float]:
        """Return the band of `nees` / `freedom` that holds it with 95 % if the σ are right."""
        low, high = (chdtri(self.freedom, p) / max(self.freedom, 1) for p in (0.975, 0.025))
        return float(low), float(high)


@dataclass
class Statistics:
    """The statistics of a campaign.

    Attributes:
        plan: the campaign.
        by_point: a tally for each (point of the grids, estimator).
        by_axis: a tally for each (axis, name of a part of it, estimator), in the order of the axis.
        worst: the trials with the largest errors, by estimator.
        done: number of trials in the folder.
        compared: number of trials that Drake repeated.
        position, angle: largest difference of the base's position [m] and attitude [rad] in these.
        drake_seconds, truth_seconds: mean time of the processor for the simulation of a trial [s].

    """

    plan: CampaignPlan
    by_point: dict[tuple[int, str], Tally] = field(default_factory=dict)
    by_axis: dict[tuple[str, str, str], Tally] = field(default_factory=dict)
    worst: dict[str, list[Worst]] = field(default_factory=dict)
    done: int = 0
    compared: int = 0
    position: float = 0.0
    angle: float = 0.0
    drake_seconds: float = 0.0
    truth_seconds: float = 0.0


def statistics_of(folder: Path) -> Statistics:
    """Return the statistics of the trials in a campaign's folder.

    Raises:
        InputError: it is no such folder, or a file is damaged.

    """
    plan = store.plan_in(folder)
    statistics = Statistics(plan)
    parts = {key: parts_of(axis) for key, axis in plan.campaign.axes.items()}
    for key, (names, _) in parts.items():
        for name in names:
            for estimator in plan.campaign.estimators:
                statistics.by_axis[key, name, estimator] = Tally()
    truth = drake = 0.0
    for table in store.read(folder, plan):
        first = table.filter(pc.equal(table["estimator"], plan.campaign.estimators[0]))
        statistics.done += len(first)
        truth += pc.sum(first["truth_seconds"]).as_py() or 0.0
        repeated = first.filter(pc.is_valid(first["drake_position"]))
        if len(repeated):
            statistics.compared += len(repeated)
            drake += pc.sum(repeated["drake_seconds"]).as_py()
            statistics.position = max(statistics.position, *repeated["drake_position"].to_pylist())
            statistics.angle = max(statistics.angle, *repeated["drake_angle"].to_pylist())
        for estimator in plan.campaign.estimators:
            own = table.filter(pc.equal(table["estimator"], estimator))
            for point in dict.fromkeys(own["point"].to_pylist()):
                rows = own.filter(pc.equal(own["point"], point))
                add(statistics.by_point.setdefault((point, estimator), Tally()), rows, plan)
            for key, (names, place) in parts.items():
                values = own[f"axis {key}"].to_pylist()
                places = np.array([place(value) for value in values])
                for k in np.unique(places):
                    add(statistics.by_axis[key, names[k], estimator], own.filter(places == k), plan)
            statistics.worst[estimator] = _worst(statistics.worst.get(estimator, []), own)
    statistics.truth_seconds = truth / max(statistics.done, 1)
    statistics.drake_seconds = drake / max(statistics.compared, 1)
    return statistics


def parts_of(axis: Axis) -> tuple[list[str], Callable[[Any], int]]:
    """Return the names of the parts of an axis, and the function from a value to a part's number.

    A list of numbers counts by its norm. The parts of a normal distribution reach two σ from the
    mean, of the number or of the norm's square.
    """
    if axis.numbers is None:
        values = [each if axis.is_number else json.dumps(each) for each in axis.values()]
        names = [f"{each:g}" if axis.is_number else str(each)[:60] for each in values]
        return names, values.index
    low, high = axis.numbers
    if axis.normal is not None:
        mean, sigma = axis.normal
        if mean.ndim:
            # |x|² has the mean |μ|² + |σ|² and the variance Σ (4 μ² σ² + 2 σ⁴).
            square = np.sum(mean**2 + sigma**2)
            spread = 2 * np.sqrt(np.sum(4 * mean**2 * sigma**2 + 2 * sigma**4))
            low, high = np.sqrt(np.maximum([square - spread, square + spread], 0.0))
        else:
            low, high = mean - 2 * sigma, mean + 2 * sigma
    elif low.ndim:
        nearest, farthest = np.maximum(low, -high).clip(min=0), np.maximum(-low, high)
        low, high = np.linalg.norm(nearest), np.linalg.norm(farthest)
    edges = np.linspace(low, high, BINS + 1)
    if axis.log_uniform is not None and low > 0:
        edges = np.geomspace(low, high, BINS + 1)
    names = [f"{a:.3g} to {b:.3g}" for a, b in pairwise(edges)]

    def place(value: Any) -> int:
        size = np.linalg.norm(json.loads(value)) if isinstance(value, str) else value
        return int(np.clip(np.searchsorted(edges, size, side="right") - 1, 0, BINS - 1))

    return names, place


def add(tally: Tally, table: pa.Table, plan: CampaignPlan) -> None:
    """Add the rows of one estimator to a tally."""
    good = table.filter(pc.is_null(table["error"]))
    tally.trials, tally.failed = tally.trials + len(table), tally.failed + len(table) - len(good)
    errors = [each for each in table["error"].to_pylist() if each]
    tally.problem = tally.problem or (errors[0] if errors else "")
    tally.seconds += pc.sum(table["identify_seconds"]).as_py() or 0.0
    if not len(good):
        return
    truth, estimate = tens(good, "truth"), tens(good, "estimate")
    error, scale = estimate - truth, scales(truth)
    is_known = np.isfinite(error)
    scaled, bound = error / scale, tens(good, "bound")
    tally.counted += is_known.sum(axis=0)
    tally.error += np.nansum(scaled, axis=0)
    tally.square += np.nansum(scaled**2, axis=0)
    tally.inside += (tens(good, "inside") == 1).sum(axis=0)
    bounded = np.isfinite(error / bound)
    tally.bounded += bounded.sum(axis=0)
    tally.ratio += np.nansum((error / bound) ** 2, axis=0)
    tally.beside += np.sum(np.where(bounded, scaled, 0) ** 2, axis=0)
    tally.bound += np.nansum(np.where(bounded, bound / scale, 0) ** 2, axis=0)
    tally.scaled += float(np.nansum(largest(scaled) ** 2))
    nees = good["nees"].to_numpy()
    freedom = good["known"].to_numpy()
    right = nees <= chdtri(freedom, WRONG_PROBABILITY)
    tally.nees, tally.freedom = tally.nees + float(nees.sum()), tally.freedom + int(freedom.sum())
    tally.verdicts.update(zip(good["passed"].to_pylist(), right.tolist()))
    for names, is_right in zip(good["failed_checks"].to_pylist(), right.tolist()):
        tally.checks.update((name, is_right) for name in dict.fromkeys(names))
    for name, requirement in plan.campaign.requirements.items():
        tally.met[name] += int((required_errors(name, truth, error) <= requirement.limit).sum())


def required_errors(name: str, truth: Array, error: Array) -> Array:
    """Return the errors (N,) that a requirement limits; NaN where not known.

    Of the mass relative to it; of the centre of mass [m]; of the inertia tensor relative to it.
    """
    if name == "mass":
        return np.abs(error[:, 0]) / truth[:, 0]
    if name == "com":
        return np.asarray(np.linalg.norm(error[:, 1:4], axis=1))
    squares = np.array([1.0, 1, 1, 2, 2, 2])  # of Ixx, Iyy, Izz, Ixy, Ixz, Iyz in the norm
    return np.asarray(np.sqrt((error[:, 4:] ** 2 @ squares) / (truth[:, 4:] ** 2 @ squares)))


def verdict(met: int, trials: int, probability: float) -> tuple[str, float]:
    """Return a verdict on a requirement, and the least share of trials that meet it.

    Both are right with the probability `CONFIDENCE`: one-sided bounds of Clopper and Pearson.
    """
    low, high = clopper_pearson(met, trials, 1 - CONFIDENCE)
    text = "met" if low >= probability else "not met" if high < probability else "not enough trials"
    return text, low


def clopper_pearson(count: float, total: float, tail: float) -> tuple[float, float]:
    """Return the bounds of a share, each of which is wrong with the probability `tail`."""
    low = float(betaincinv(count, total - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, total - count, 1 - tail)) if count < total else 1.0
    return low, high


def tens(table: pa.Table, name: str) -> Array:
    """Return a column of lists of ten as (N, 10); NaN where null."""
    nothing = [None] * 10
    return np.array([each or nothing for each in table[name].to_pylist()], dtype=float)


def scales(truth: Array) -> Array:
    """Return the scales (N, 10) of parameters (N, 10)."""
    return np.array([parameter_scale(each, SCALE_LENGTH) for each in truth])


def largest(scaled: Array) -> Array:
    """Return the largest absolute entries (N,) of rows (N, 10), of those that are known."""
    return np.asarray(np.nanmax(np.abs(scaled), axis=1, initial=0.0))


def _worst(before: list[Worst], table: pa.Table) -> list[Worst]:
    """Return the worst trials of those before and of a table."""
    good = table.filter(pc.is_null(table["error"]))
    if not len(good):
        return before
    truth = tens(good, "truth")
    errors = largest((tens(good, "estimate") - truth) / scales(truth))
    checks = [", ".join(each) for each in good["failed_checks"].to_pylist()]
    columns = (good["trial"].to_pylist(), errors, good["nees"].to_pylist(), checks)
    rows = [Worst(n, float(e), x, c) for n, e, x, c in zip(*columns)]
    return sorted([*before, *rows], key=lambda each: -each.error)[:WORST]


def _root(squares: Array, counts: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(np.where(counts > 0, squares / counts, np.nan)))
