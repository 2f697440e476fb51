"""Online estimation from a vague prior: a trajectory fit until it is safe to filter.

With hardly any motion seen, every error of a sensor looks like a sign of the target: a filter that
takes samples one by one would never forget what it made of the first ones. So the samples are kept
at first and fitted together, again and again at growing intervals; once the target is known well
enough (`MomentumFilter.well_known`), the filter goes on from the last fit, sample by sample.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.estimators.momentum_filter import (
    ANGULAR,
    BIAS,
    BY_GYRO,
    BY_MOMENTUM,
    COM,
    FILTER_ORDER,
    PSI,
    VELOCITY,
    FilterState,
    MomentumFilter,
)
from cpid_drake.estimators.trajectory_fit import TrajectoryFit, fit_trajectory
from cpid_drake.estimators.trajectory_model import TrajectoryModel
from cpid_drake.kinematics import KinematicTree
from cpid_drake.sensors import Measurements, Samples
from cpid_drake.smoothing import smooth_joints

FIRST_FIT, NEXT_FIT, LONGEST_FIT = 1.0, 1.3, 60.0
"""When the first fit is made, by what factor later each next one, the last at the latest [s]."""


@dataclass(eq=False)
class OnlineState:
    """What is remembered: the filter's state, and until it runs alone, all samples.

    Attributes:
        filter: its state; ψ and its covariance are the estimate at any time.
        samples: (sensor, time, value) so far, while there are fits to make.
        next_fit: when the next fit is due [s]; NaN once the filter runs alone.
        first_time: of all samples; NaN before.

    """

    filter: FilterState
    samples: list[tuple[str, float, NDArray[np.float64]]] = field(default_factory=list)
    next_fit: float = -np.inf
    first_time: float = np.nan

    @property
    def acquiring(self) -> bool:
        """Whether the target is still estimated by fits."""
        return not np.isnan(self.next_fit)


class OnlineEstimator:
    """Fits first, filters then; it holds no state.

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

    def take(self, state: OnlineState, name: str, time: float, value: NDArray) -> None:
        """Take one sample of a sensor in, in place; see `MomentumFilter.update`."""
        if not state.acquiring:
            self.filter.take(state.filter, name, time, value)
            return
        if not self._usable(state, name, time, value):
            state.filter.rejected[self.filter.index(name)] += 1
            return
        if np.isnan(state.first_time):
            state.first_time, state.next_fit = time, time + FIRST_FIT
        if time > state.next_fit:
            self._fit(state)
            if not state.acquiring:
                self.filter.take(state.filter, name, time, value)
                return
            elapsed = state.next_fit - state.first_time
            state.next_fit = state.first_time + elapsed * NEXT_FIT
        k = self.filter.index(name)
        state.filter.used[k] += 1
        state.filter.times[k] = time
        state.samples.append((name, time, np.array(value)))

    def _usable(self, state: OnlineState, name: str, time: float, value: NDArray) -> bool:
        """Whether a sample passes the checks that need no prediction."""
        k = self.filter.index(name)
        good = np.isfinite(time) and np.isfinite(value).all() and time > state.filter.times[k]
        if good and name == "attitude":
            good = abs(np.sqrt(value @ value) - 1) < 1e-3
        newest = state.filter.times.max()
        return bool(good and (np.isinf(newest) or -1.0 < time - newest < LONGEST_FIT))

    def _fit(self, state: OnlineState) -> None:
        """Fit all samples so far, and decide whether the filter can go on alone."""
        prior = self.filter.prior
        measurements = self._measurements(state.samples)
        try:
            model = TrajectoryModel(
                self.tree,
                smooth_joints(measurements, self.filter.suite),
                measurements,
                self.filter.suite,
                unknown_momentum=not prior.momentum_known,
                psi_prior=(prior.psi, prior.psi_sigma),
            )
            fit = fit_trajectory(model, prior.psi, robust=True)
        except InputError:
            return  # too few samples yet
        used, rejected = state.filter.used, state.filter.rejected
        times = state.filter.times
        state.filter = self.filter_state(fit)
        state.filter.used[:], state.filter.rejected[:] = used, rejected
        state.filter.times[:] = times
        late = state.next_fit - state.first_time > LONGEST_FIT
        if fit.converged and (late or self.filter.well_known(state.filter)):
            state.next_fit, state.samples = np.nan, []

    def filter_state(self, fit: TrajectoryFit) -> FilterState:
        """Return the filter's state at the end of a fit."""
        model, trajectory, now = fit.model, fit.trajectory, fit.trajectory.state
        state = self.filter.start()
        scale = 1 / np.sqrt(np.maximum(np.diag(fit.information), 1e-300))
        scaled = fit.information * scale * scale[:, None]
        covariance = np.linalg.inv(scaled) * scale * scale[:, None] + fit.consider
        # How the filter's error state at the end follows from the fit's unknowns.
        F = np.zeros((len(state.P), model.size))
        elapsed = model.nodes[-1] - model.nodes[0]
        columns = model.columns
        F[PSI, columns["psi"]] = np.eye(10)
        F[BY_GYRO] = F[BY_MOMENTUM] = model.end_change(trajectory)
        if "p_Wcm" in columns:
            F[COM, columns["p_Wcm"]] = np.eye(3)
        if "v_Wcm" in columns:
            F[COM, columns["v_Wcm"]] = elapsed * np.eye(3)
            F[VELOCITY, columns["v_Wcm"]] = np.eye(3)
        if "L" in columns:
            F[ANGULAR, columns["L"]] = np.eye(3)
        if len(now.bias):
            last = slice(columns["bias"].stop - 3, columns["bias"].stop)
            F[BIAS, last] = np.eye(3)
            state.bias[:] = now.bias[-1]
        state.P = F @ covariance @ F.T
        state.psi[:] = now.psi
        state.R_by_gyro, state.R_by_momentum = trajectory.R[-1].copy(), trajectory.R[-1].copy()
        state.p_Wcm[:] = now.p_Wcm + elapsed * now.v_Wcm
        state.L[:], state.v_Wcm[:] = now.L, now.v_Wcm
        self.filter.resume(
            state, model.nodes[-1], model.joints.evaluate(model.nodes[-1])[0], model.measurements
        )
        return state

    def _measurements(self, samples: list) -> Measurements:
        widths = dict.fromkeys(("gyro", "position", "velocity"), 3) | {"attitude": 4}
        widths |= dict.fromkeys(("encoders", "joint_rates"), len(self._joint_names))
        parts = {}
        for name, width in widths.items():
            mine = [(time, value) for sensor, time, value in samples if sensor == name]
            parts[name] = Samples(
                np.array([time for time, _ in mine]),
                np.array([value for _, value in mine]).reshape(-1, width),
            )
        return Measurements(self._joint_names, **parts)

    def run(self, measurements: Measurements) -> OnlineState:
        """Return the state after all samples of some measurements, taken in order of time."""
        state = self.start()
        for name, time, value in in_order(measurements):
            self.take(state, name, time, value)
        return state


def in_order(measurements: Measurements) -> list[tuple[str, float, NDArray[np.float64]]]:
    """Return all samples in order of time, those of one instant in `FILTER_ORDER`."""
    samples = [
        (round(time * 1e9), rank, name, time, value)
        for rank, name in enumerate(FILTER_ORDER)
        for time, value in zip(getattr(measurements, name).time, getattr(measurements, name).value)
    ]
    samples.sort(key=lambda sample: sample[:2])
    return [sample[2:] for sample in samples]
