"""Online estimation from a vague prior: trajectory fits first, the momentum filter afterwards.

Sensor errors look like effects of the target until enough motion has been observed. A filter that
processes samples one by one cannot correct wrong conclusions from the first samples. Therefore the
samples are stored at first, and all of them are fitted together at growing intervals. Once the
target is known well enough (`MomentumFilter.well_known`), the filter continues from the last fit,
sample by sample.

If no constant momentum explains the stored samples, a thruster has fired. The samples are
discarded, and the estimation starts again with an unknown momentum.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.estimation.likelihood.model import TrajectoryModel
from cpid_drake.estimation.momentum_filter import (
    ANGULAR,
    BIAS,
    BY_GYRO,
    BY_MOMENTUM,
    COM,
    FILTER_ORDER,
    LONGEST_GAP,
    PSI,
    SPIKE,
    VELOCITY,
    FilterState,
    MomentumFilter,
)
from cpid_drake.estimation.trajectory_fit import TrajectoryFit, fit_trajectory
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.splines import smooth_joints

FIRST_FIT, NEXT_FIT, LONGEST_FIT = 1.0, 1.3, 60.0
"""Time of the first fit [s], ratio of the times of successive fits, latest time of a fit [s]."""

MISFIT = 4.0
"""Excess of χ², in σ, above which the momentum cannot have been constant."""

FEW = 0.05
"""Largest share of samples that can be outliers."""

FASTEST_BASE = {"attitude": 0.5, "position": 1.0, "velocity": 1.0}
"""Largest rate of change of each reading; faster changes are spikes [rad/s, m/s, m/s²]."""


@dataclass(eq=False)
class OnlineState:
    """The filter's state and, while the target is estimated by fits, all samples.

    Attributes:
        filter: the filter's state; its ψ and the covariance of ψ are the estimate at any time.
        samples: (sensor, time, value) so far; empty once the filter runs alone.
        next_fit: time of the next fit [s]; NaN once the filter runs alone.
        first_time: time of the first sample [s]; NaN before.

    """

    filter: FilterState
    samples: list[tuple[str, float, NDArray[np.float64]]] = field(default_factory=list)
    next_fit: float = -np.inf
    first_time: float = np.nan

    @property
    def initializing(self) -> bool:
        """Whether the target is still estimated by fits."""
        return not np.isnan(self.next_fit)


class OnlineEstimator:
    """Estimates the target by fits at first, then by the filter; it contains no state.

    Args:
        tree: the known spacecraft.
        joint_names: its joints.
        momentum_filter: the filter, with its sensors and prior.

    """

    def __init__(
        self, tree: KinematicTree, joint_names: tuple[str, ...], momentum_filter: MomentumFilter
    ) -> None:
        self.tree, self._joint_names = tree, joint_names
        self.filter = momentum_filter

    def start(self) -> OnlineState:
        """Return the state before the first sample."""
        return OnlineState(self.filter.start())

    def process(self, state: OnlineState, name: str, time: float, value: NDArray) -> None:
        """Process one sample and update the state in place; see `MomentumFilter.process`."""
        for sample in self.filter.screen(state.filter, name, time, value):
            self._use(state, *sample)

    def _use(self, state: OnlineState, name: str, time: float, value: NDArray) -> None:
        if state.initializing and name == "encoders" and self._joints_lost(state, time):
            state.samples, state.first_time = [], np.nan
        if state.initializing and np.isnan(state.first_time):
            state.first_time, state.next_fit = time, time + FIRST_FIT
        if state.initializing and time > state.next_fit:
            self._fit(state, time)
        if not state.initializing:
            self.filter.update(state.filter, name, time, value)
            return
        state.filter.used[self.filter.index(name)] += 1
        state.samples.append((name, time, np.array(value)))

    def _joints_lost(self, state: OnlineState, time: float) -> bool:
        """Return whether the last encoder sample is too old to interpolate the joint motion."""
        longest = max(LONGEST_GAP, 5 / self.filter.suite["encoders"].rate)
        for sensor, last, _ in reversed(state.samples):
            if sensor == "encoders":
                return time - last > longest
        return False

    def _fit(self, state: OnlineState, time: float) -> None:
        """Fit all samples so far, and decide whether the filter can run alone from now on."""
        elapsed = state.next_fit - state.first_time
        state.next_fit = state.first_time + elapsed * NEXT_FIT
        self._drop_spikes(state)
        fit = self._fitted(state)
        if fit is not None and _misfit(fit) and self._drop_outliers(state, fit):
            fit = self._fitted(state)
        if fit is None:
            return
        if _misfit(fit):
            self._begin_anew(state, time)
            return
        found = self.filter_state(fit)
        found.keep_screening(state.filter)
        state.filter = found
        if fit.converged and (elapsed * NEXT_FIT > LONGEST_FIT or self.filter.well_known(found)):
            state.next_fit, state.samples = np.nan, []

    def _fitted(self, state: OnlineState) -> TrajectoryFit | None:
        """Return the fit of all samples so far; None if there are too few."""
        prior, known = self.filter.prior, bool(state.filter.momentum_known)
        measurements = self._measurements(state.samples)
        try:
            model = TrajectoryModel(
                self.tree,
                smooth_joints(measurements, self.filter.suite),
                measurements,
                self.filter.suite,
                momentum=TotalMomentum(prior.L, prior.v_Wcm, is_unknown=not known),
                psi_prior=(prior.psi, prior.psi_sigma),
            )
            return fit_trajectory(model, prior.psi, robust=True)
        except (InputError, np.linalg.LinAlgError):
            return None

    def _begin_anew(self, state: OnlineState, time: float) -> None:
        """Discard all samples, because the momentum has changed between them."""
        start = self.filter.start()
        start.keep_screening(state.filter)
        if start.momentum_known:
            self.filter.open_momentum(start)
        start.momentum_changes += 1
        start.momentum_change_time = np.float64(time)
        state.filter, state.samples = start, []
        state.first_time, state.next_fit = time, time + FIRST_FIT

    def _drop_spikes(self, state: OnlineState) -> None:
        """Reject samples that agree with none of their neighbours in time."""
        for name, fastest in FASTEST_BASE.items():
            if getattr(self.filter.suite, name) is None:
                continue
            sigma = self.filter.suite.sigmas(name).max()
            mine = [k for k, sample in enumerate(state.samples) if sample[0] == name]
            bad = _spikes(name, [state.samples[k] for k in mine], fastest, SPIKE * sigma)
            self._drop(state, [k for k, is_bad in zip(mine, bad) if is_bad])

    def _drop_outliers(self, state: OnlineState, fit: TrajectoryFit) -> bool:
        """Reject a few samples that do not fit while the others do; return whether any exist."""
        model = fit.model
        rows = model.sample_rows()
        of_samples = rows >= 0
        squares = model.residuals(fit.trajectory)[of_samples] ** 2
        size = np.sqrt(np.bincount(rows[of_samples], squares) / 3)
        names = np.repeat(
            list(model.sensors), [len(getattr(model.measurements, n)) for n in model.sensors]
        )
        far = np.zeros(len(size), dtype=bool)
        for name in model.sensors:
            mine = names == name
            far[mine] = size[mine] > SPIKE * max(np.median(size[mine]), 1.0)
        if not 0 < far.sum() <= FEW * len(size):
            return False
        times = np.concatenate([getattr(model.measurements, n).time for n in model.sensors])
        out = set(zip(names[far], times[far]))
        self._drop(state, [k for k, s in enumerate(state.samples) if (s[0], s[1]) in out])
        return True

    def _drop(self, state: OnlineState, places: list[int]) -> None:
        """Reject the samples at these places, and count them."""
        for k in places:
            sensor = self.filter.index(state.samples[k][0])
            state.filter.used[sensor] -= 1
            state.filter.rejected[sensor] += 1
        out = set(places)
        state.samples = [sample for k, sample in enumerate(state.samples) if k not in out]

    def filter_state(self, fit: TrajectoryFit) -> FilterState:
        """Return the filter's state at the end of a fit."""
        model, trajectory, now = fit.model, fit.trajectory, fit.trajectory.state
        state = self.filter.start()
        scale = 1 / np.sqrt(np.maximum(np.diag(fit.information), 1e-300))
        scaled = fit.information * scale * scale[:, None]
        covariance = np.linalg.inv(scaled) * scale * scale[:, None] + fit.consider
        # The derivative of the filter's error state at the end with respect to the fit's unknowns.
        F = np.zeros((len(state.P), model.size))
        elapsed = model.nodes[-1] - model.nodes[0]
        columns = model.columns
        F[PSI, columns["psi"]] = np.eye(10)
        F[BY_GYRO] = F[BY_MOMENTUM] = model.end_attitude_jacobian(trajectory)
        if "p_Wcm" in columns:
            F[COM, columns["p_Wcm"]] = np.eye(3)
        if "v_Wcm" in columns:
            F[COM, columns["v_Wcm"]] = elapsed * np.eye(3)
            F[VELOCITY, columns["v_Wcm"]] = np.eye(3)
        if "L" in columns:
            F[ANGULAR, columns["L"]] = np.eye(3)
            state.momentum_known = np.False_
        if len(now.bias):
            last = slice(columns["bias"].stop - 3, columns["bias"].stop)
            F[BIAS, last] = np.eye(3)
            state.bias[:] = now.bias[-1]
        state.P = F @ covariance @ F.T
        if "L" in columns and "v_Wcm" not in columns:
            state.P[VELOCITY, VELOCITY] = self.filter.prior.velocity**2 * np.eye(3)
        state.psi[:] = now.psi
        state.R_by_gyro, state.R_by_momentum = trajectory.R[-1].copy(), trajectory.R[-1].copy()
        state.p_Wcm[:] = now.p_Wcm + elapsed * now.v_Wcm
        state.L[:], state.v_Wcm[:] = now.L, now.v_Wcm
        self.filter.resume(
            state, model.nodes[-1], model.joints.evaluate(model.nodes[-1])[0], model.measurements
        )
        return state

    def _measurements(self, samples: list) -> Measurements:
        parts = {}
        for name in dict.fromkeys(sensor for sensor, _, _ in samples):
            mine = [(time, value) for sensor, time, value in samples if sensor == name]
            times, values = zip(*mine)
            parts[name] = Samples(np.array(times), np.array(values))
        return Measurements(self._joint_names, parts)

    def run(self, measurements: Measurements) -> OnlineState:
        """Return the state after all samples of some measurements, processed in order of time."""
        state = self.start()
        for name, time, value in in_order(measurements):
            self.process(state, name, time, value)
        return state


def _misfit(fit: TrajectoryFit) -> bool:
    """Return whether χ² is larger than noise can explain."""
    return bool(fit.chi_squared > fit.rows + MISFIT * np.sqrt(2 * fit.rows))


def _spikes(name: str, samples: list, fastest: float, limit: float) -> list[bool]:
    """Return which samples are further from both neighbours than these are from each other.

    The neighbours of the first sample are the two after it; of the last, the two before it.
    """
    if len(samples) < 3:
        return len(samples) * [False]
    times, values = np.array([s[1] for s in samples]), np.array([s[2] for s in samples])

    def apart(i: NDArray, j: NDArray) -> NDArray:
        """Return whether two samples are too far from each other."""
        if name == "attitude":
            cosine = np.abs(np.einsum("ni,ni->n", values[i], values[j]))
            distance = 2 * np.arccos(np.minimum(cosine, 1.0))
        else:
            distance = np.linalg.norm(values[i] - values[j], axis=1)
        return distance > limit + fastest * np.abs(times[i] - times[j])

    k = np.arange(len(samples))
    one = np.where(k == 0, 1, np.where(k == k[-1], k - 2, k - 1))
    other = np.where(k == 0, 2, np.where(k == k[-1], k - 1, np.minimum(k + 1, k[-1])))
    return list(apart(k, one) & apart(k, other) & ~apart(one, other))


def in_order(measurements: Measurements) -> list[tuple[str, float, NDArray[np.float64]]]:
    """Return all samples in order of time, those of one instant in `FILTER_ORDER`."""
    samples = [
        (round(time * 1e9), rank, name, time, value)
        for rank, name in enumerate(FILTER_ORDER)
        for time, value in zip(getattr(measurements, name).time, getattr(measurements, name).value)
    ]
    samples.sort(key=lambda sample: sample[:2])
    return [sample[2:] for sample in samples]
