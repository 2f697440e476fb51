"""The momentum balance of a smoothed motion under hypotheses about what is wrong with a log.

A hypothesis changes the motion or the tree, with a few parameters. Its misfit is the size of the
residuals of the standard rows, in units of their errors, after a fit of the target, of a constant
momentum and of the hypothesis's own parameters. The right hypothesis has a misfit of about one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.rows import STANDARD_ROWS
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.momentum_rows import momentum_rows, row_jacobian

Array = NDArray[np.float64]

_STEP = 1e-6
_MOST_STEPS = 6
_SHARES = (1.0, 0.5, 0.2, 0.05)  # of a step; the first one that improves the fit is taken
_UNKNOWN = TotalMomentum.unknown()


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One possible cause of a log that contradicts the conservation of momentum.

    Attributes:
        text: returns a sentence from the parameters.
        changed: returns the tree and the motion without the cause, from the parameters (size,);
            None if the hypothesis adds columns only.
        size: number of parameters of `changed`.
        columns: (6 N, k) further columns of the rows in C, without weights; None for none.
        sizes: (k,) σ of the plausible unknowns of the columns; None for any values.
        weighed: returns the tree with the unknowns (k,) of the columns, for the weights of the
            rows, or None if there is no such tree; None if the columns do not change the tree.
        starts: values of the first parameter from which the fit starts.
        largest: largest size of a plausible parameter.

    """

    text: Callable[[Array], str]
    changed: Callable[[Array], tuple[KinematicTree, Telemetry]] | None = None
    size: int = 0
    columns: Array | None = None
    sizes: Array | None = None
    weighed: Callable[[Array], KinematicTree | None] | None = None
    starts: tuple[float, ...] = (0.0,)
    largest: float = np.inf

    @property
    def freedom(self) -> int:
        """Number of free parameters and columns."""
        return self.size + (0 if self.columns is None else self.columns.shape[1])


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of one hypothesis.

    Attributes:
        hypothesis: the hypothesis.
        misfit: size of the residuals in units of their errors.
        parameters: parameters of the hypothesis, then the unknowns of its columns.
        unknowns: (16,) momentum and target.

    """

    hypothesis: Hypothesis
    misfit: float
    parameters: Array = field(default_factory=lambda: np.empty(0))
    unknowns: Array = field(default_factory=lambda: np.empty(0))

    @property
    def is_plausible(self) -> bool:
        """Whether the unknowns of the columns are those of a possible spacecraft."""
        weighed, size = self.hypothesis.weighed, self.hypothesis.size
        return weighed is None or weighed(self.parameters[size:]) is not None

    @property
    def text(self) -> str:
        """The hypothesis in words."""
        return self.hypothesis.text(self.parameters)


class MomentumBalance:
    """The rows of one smoothed motion, with weights from its errors.

    Args:
        tree: the known spacecraft.
        motion: N samples.
        covariance: (N, n, n) covariance of the motion; see `SmoothedMotion.covariance`.

    Attributes:
        expected: the fit without any cause, with weights that belong to its solution.

    """

    def __init__(self, tree: KinematicTree, motion: Telemetry, covariance: Array) -> None:
        self.tree, self.motion, self._covariance = tree, motion, covariance
        nothing = Hypothesis(lambda p: "")
        # Weights of the spacecraft alone: those of a wrong target would favour wrong hypotheses.
        self._weights = self._weights_at(Fit(nothing, 1.0, np.empty(0), np.zeros(16)))
        self.expected = self.reweighted(self.reweighted(self.fitted(nothing)))
        self._target = self.expected.unknowns

    def fitted(self, hypothesis: Hypothesis, *, steps: int = _MOST_STEPS) -> Fit:
        """Return the best fit of a hypothesis, by Gauss-Newton from each of its starts."""
        if hypothesis.weighed is not None:  # the weights of the spacecraft alone mislead
            return self.reweighted(Fit(hypothesis, np.inf, _nothing(hypothesis), self._target))
        if not hypothesis.size:
            return self._solved(hypothesis, np.empty(0))
        fits = []
        for start in hypothesis.starts:
            parameters = np.zeros(hypothesis.size)
            parameters[0] = start
            fits.append(self._refined(hypothesis, parameters, steps))
        return min(fits, key=lambda fit: fit.misfit)

    def reweighted(self, fit: Fit) -> Fit:
        """Return the fit of the same hypothesis with weights that belong to its own solution."""
        other = object.__new__(MomentumBalance)
        other.tree, other.motion, other._covariance = self.tree, self.motion, self._covariance
        other._weights = self._weights_at(fit)
        hypothesis = fit.hypothesis
        if not hypothesis.size:
            return other._solved(hypothesis, np.empty(0))
        return other._refined(hypothesis, fit.parameters[: hypothesis.size], 2)

    def _weights_at(self, fit: Fit) -> Array:
        tree, motion = self._changed(fit.hypothesis, fit.parameters)
        if fit.hypothesis.weighed is not None:
            tree = fit.hypothesis.weighed(fit.parameters[fit.hypothesis.size :]) or tree
        J = row_jacobian(motion, tree, STANDARD_ROWS, _UNKNOWN, fit.unknowns)
        S = J @ self._covariance @ np.swapaxes(J, -1, -2)
        S += (1e-9 * np.trace(S, axis1=1, axis2=2) / 6 + 1e-300)[:, None, None] * np.eye(6)
        return np.linalg.inv(np.linalg.cholesky(S))

    def _changed(self, hypothesis: Hypothesis, p: Array) -> tuple[KinematicTree, Telemetry]:
        if hypothesis.changed is None:
            return self.tree, self.motion
        return hypothesis.changed(p[: hypothesis.size])

    def _rows(self, hypothesis: Hypothesis, p: Array) -> Array:
        """Return weighted rows [columns | N | A | b] (6 N, k + 17), and those of `sizes`."""
        tree, motion = self._changed(hypothesis, p)
        rows = momentum_rows(tree, motion, STANDARD_ROWS, _UNKNOWN)
        if hypothesis.columns is not None:
            rows = np.hstack([hypothesis.columns, rows])
        rows = (self._weights @ rows.reshape(len(motion), 6, -1)).reshape(len(rows), -1)
        if hypothesis.sizes is None:
            return rows
        prior = np.eye(len(hypothesis.sizes), rows.shape[1]) / hypothesis.sizes[:, None]
        return np.vstack([rows, prior])

    def _solved(self, hypothesis: Hypothesis, p: Array, rows: Array | None = None) -> Fit:
        rows = self._rows(hypothesis, p) if rows is None else rows
        x = _least_squares(rows[:, :-1], rows[:, -1])
        misfit = float(np.sqrt(np.mean((rows[:, -1] - rows[:, :-1] @ x) ** 2)))
        return Fit(hypothesis, misfit, np.concatenate([p, x[:-16]]), x[-16:])

    def _refined(self, hypothesis: Hypothesis, p: Array, steps: int) -> Fit:
        rows = self._rows(hypothesis, p)
        best = self._solved(hypothesis, p, rows)
        for _ in range(steps):
            x = np.concatenate([best.parameters[hypothesis.size :], best.unknowns])
            slopes = []
            for shift in _STEP * np.eye(hypothesis.size):
                change = self._rows(hypothesis, p + shift) - rows
                slopes.append((change[:, :-1] @ x - change[:, -1]) / _STEP)
            A = np.hstack([np.array(slopes).T, rows[:, :-1]])
            step = _least_squares(A, rows[:, -1])[: hypothesis.size]
            for share in _SHARES:
                point = np.clip(p + share * step, -hypothesis.largest, hypothesis.largest)
                rows = self._rows(hypothesis, point)
                latest = self._solved(hypothesis, point, rows)
                if latest.misfit < best.misfit:
                    break
            else:
                break
            is_last = latest.misfit > 0.98 * best.misfit
            best, p = latest, point
            if is_last:
                break
        return best


def _nothing(hypothesis: Hypothesis) -> Array:
    """Return parameters of a hypothesis that change nothing."""
    return np.zeros(hypothesis.freedom)


def _least_squares(A: Array, b: Array) -> Array:
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    return np.asarray(np.linalg.lstsq(A / size, b, rcond=1e-9)[0] / size)
