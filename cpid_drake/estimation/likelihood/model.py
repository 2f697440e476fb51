"""The likelihood of the samples in one block of time: residuals and their derivatives."""

from copy import copy
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.plane import HELD, NORMAL_W
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.gaussian import indices_of, places_of
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.effect_terms import (
    WRITERS,
    Write,
    write_bodies,
    write_force,
    write_joints,
    write_start,
    write_target,
)
from cpid_drake.estimation.likelihood.joint_model import ORDER, JointPart
from cpid_drake.estimation.likelihood.kinematic_changes import with_changes
from cpid_drake.estimation.likelihood.motion_change import MotionChange, response
from cpid_drake.estimation.likelihood.motion_model import BaseMotion, Trajectory, TrajectoryState
from cpid_drake.estimation.likelihood.sensor_models import SensorModel, clock_of, model_classes
from cpid_drake.estimation.likelihood.white_reading import WhiteReading
from cpid_drake.logs.log import Log
from cpid_drake.sensors.suite import SensorSuite

STEP = 0.025
"""Longest step of the grid on which the base's attitude is integrated [s]."""

SLOW = "slow"
"""Name of the columns of slow noise; see `process`."""


class BlockModel:
    """Predicts the samples of the base's sensors in one block of time.

    Args:
        tree: the spacecraft model.
        joints: its joint motion in the block.
        measurements: samples in the block of sensors in the suite.
        suite: the sensors' errors.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.
        step: longest step of the grid [s].
        constants: the constant errors; default: those of the suite.
        nominal: (k,) values of the constant errors about which delays, joint zeros and thrust are
            linear, in units of their σ; default: zero.
        errors: (c,) errors of the spacecraft's bodies in units of their σ, which the tree already
            has; default: zero.
        origin: see `BaseMotion`.

    Attributes:
        motion: the base's motion.
        sensors: models of the sensors that have samples, by name.
        effects: the function that writes each effect on the motion, by name.
        columns: columns of each effect in the Jacobian, in this order: start 12, joints J K, slow
            noise 2 s (see `with_slow`), white forces, constant errors, ψ 10, bodies.
        width: their number.
        at_start, at_end: columns of the base's state and of the joints at both ends.

    """

    def __init__(
        self,
        tree: KinematicTree,
        joints: JointPart,
        measurements: Log,
        suite: SensorSuite,
        known_bodies: BodyUncertainty | None = None,
        step: float = STEP,
        constants: Constants | None = None,
        nominal: Array | None = None,
        errors: Array | None = None,
        origin: float = 0.0,
    ) -> None:
        classes = model_classes(measurements, suite)
        constants = constants or Constants.of(suite, joints.coefficients.shape[1])
        nominal = np.zeros(constants.size) if nominal is None else nominal
        clock = {n: clock_of(n, measurements[n].time, constants, nominal, origin) for n in classes}
        at = [measurements[n].time - clock[n][0] for n, each in classes.items() if each.at_instants]
        times = np.concatenate([np.empty(0), *at])
        thrust = thrust_log(measurements.thrust, suite.thrusters, constants, nominal)
        about = constants, nominal, origin
        of_craft = tree, known_bodies, errors
        self.motion = BaseMotion(*of_craft, joints, times, step, *about, suite, thrust)
        self.sensors: dict[str, SensorModel | WhiteReading] = {}
        first = len(self.motion.nodes)
        for name, model in classes.items():
            count = len(measurements[name]) if model.at_instants else 0
            rows, samples = slice(first, first + count), measurements[name]
            self.sensors[name] = model(name, samples, suite, self.motion, rows, clock[name])
            first += count
        K, J = joints.coefficients.shape
        sizes = {"start": 12, "joints": K * J}
        self.effects: dict[str, Write] = {"start": write_start, "joints": write_joints}
        for force in self.motion.white:
            self.sensors[force.name] = WhiteReading(self.motion, force)
            sizes[force.name] = force.size
            self.effects[force.name] = partial(write_force, force)
        for name, error in constants.errors.items():
            sizes[name] = error.size
            if error.effect.way in WRITERS:
                self.effects[name] = partial(WRITERS[error.effect.way], error)
        sizes["psi"], self.effects["psi"] = 10, write_target
        if known_bodies is not None:
            sizes["bodies"], self.effects["bodies"] = len(self.motion.body_errors), write_bodies
        self._sizes, self.columns, self.width = sizes, places_of(sizes), sum(sizes.values())
        # The columns of a change of the motion: only some errors have one.
        self._effect_columns = places_of({name: sizes[name] for name in self.effects})
        self._with_rates = "velocity" in classes
        self._of_joints = np.arange(12, 12 + K * J).reshape(J, K)
        self.slow = 0
        self.at_start, self.at_end = self._ends(0)

    def _ends(self, slow: int) -> list[NDArray[np.intp]]:
        last = 12 + self._of_joints.size + np.arange(2 * slow).reshape(2, slow)
        return [
            np.concatenate([np.arange(12), self._of_joints[:, ends].ravel(), own])
            for ends, own in zip((slice(ORDER), slice(-ORDER, None)), last, strict=True)
        ]

    def with_slow(self, slow: int) -> "BlockModel":
        """Return the model with so many entries of slow noise at both of its edges.

        Their columns, those of the start and those of the end, follow those of the joints.
        """
        if slow == self.slow:
            return self
        made, sizes = copy(self), self._sizes
        first = {"start": 12, "joints": sizes["joints"], SLOW: 2 * slow}
        made.columns = places_of({**first, **{n: s for n, s in sizes.items() if n not in first}})
        made.slow, made.width = slow, sum(sizes.values()) + 2 * slow
        made.at_start, made.at_end = made._ends(slow)
        return made

    @property
    def without_slow(self) -> NDArray[np.intp]:
        """The columns but those of slow noise."""
        first = 12 + self._of_joints.size
        return np.asarray(np.r_[:first, first + 2 * self.slow : self.width])

    def jacobian(self, trajectory: Trajectory) -> tuple[Array, Array]:
        """Return the derivatives (m, n) of the predictions in units of σ, and (12, n) of the end.

        The latter are those of attitude (a rotation in W), centre of mass, L and velocity at the
        block's end. The columns are `columns`, those of the spacecraft's bodies included.
        """
        columns, places = self.columns, self._effect_columns
        joints = places["joints"]
        if not trajectory.by:
            trajectory = next(with_changes([trajectory]))
        n = sum(place.stop - place.start for place in places.values())
        change = MotionChange.zeros(trajectory, n, with_rates=self._with_rates)
        for name, write in self.effects.items():
            write(trajectory, change.columns(places[name]))
        # From here on, δω has that by the attitude.
        change, xi, end_change = response(trajectory, change)
        if self.motion.tree.normal_B is not None:
            xi = xi * NORMAL_W[:, None]  # the table holds the tilt
        by_errors = self.motion.joint_errors.of_coefficients()

        def write_all(rows: Array, by: Array) -> None:
            """Write the derivatives (n, m) by all unknowns from those (m, ...) by effects."""
            for name, place in places.items():
                rows[columns[name]] = by[:, place].T
            for name, of_error in by_errors.items():
                rows[columns[name]] = (by[:, joints] @ of_error).T

        parts = dict[str, Array]()
        for name, sensor in self.sensors.items():
            parts[name] = sensor.normalized(sensor.jacobian(trajectory, change, xi))
        ends = np.cumsum([0, *(by[..., 0].size for by in parts.values())]).tolist()
        J, end_jacobian = np.zeros((self.width, ends[-1])), np.zeros((self.width, 12))
        write_all(end_jacobian, end_change)
        for (name, by), first, last in zip(parts.items(), ends[:-1], ends[1:], strict=True):
            write_all(J[:, first:last], by.reshape(last - first, -1))
            sensor = self.sensors[name]
            for unknown, of_reading in sensor.by_unknowns(trajectory).items():
                own = sensor.normalized(of_reading).reshape(last - first, -1)
                J[columns[unknown], first:last] += own.T
        rows, end, held = J.T, end_jacobian.T, self.held
        # What a table holds has no effect but for rounding, which would grow from block to block.
        rows[:, held] = end[:, held] = 0.0
        fixed = held[held < len(end)]
        end[fixed] = 0.0
        end[fixed, fixed] = 1.0
        return rows, end

    @property
    def of_first_order(self) -> NDArray[np.intp]:
        """The columns of errors of first order; see `Constants`."""
        return indices_of(self.columns, self.motion.constants.of_first_order)

    def scale_of(self, name: str) -> Array:
        """Return σ (d,) of the components of a sensor's samples [SI units]."""
        sensor = self.sensors[name]
        return sensor.scale if isinstance(sensor, SensorModel) else np.ones(1)

    @property
    def held(self) -> NDArray[np.intp]:
        """Columns of the quantities that a table holds; none without a table."""
        if self.motion.tree.normal_B is None:
            return np.empty(0, dtype=np.intp)
        firsts = {"attitude": 0, "p_Wcm": 3, "L": 6, "v_Wcm": 9}
        firsts |= {name: place.start for name, place in self.columns.items()}
        places = [firsts[name] + np.array(HELD[name]) for name in HELD.keys() & firsts.keys()]
        return np.concatenate(places)

    @property
    def shared_start(self) -> int:
        """First column of what blocks share: constant errors, ψ and bodies, to the last one."""
        return int(self.columns["psi"].start) - self.motion.constants.size

    def joint_triangle(self, order: NDArray[np.intp]) -> Array:
        """Return rows [A | b] of the joints' own sensors, each at its joint's column.

        With columns in an order in which those of one joint stay in theirs, they are a triangle
        (n + 1, n + 1).
        """
        joints, place = self.motion.joints, np.argsort(order)[self.columns["joints"]]
        n, place = len(order), place.reshape(joints.rest.shape)
        T = np.zeros((n + 1, n + 1), order="F")
        T[place[:, :, None], place[:, None]] = joints.rows
        T[place, -1] = joints.rest
        return T


def jump_between(state: TrajectoryState, other: TrajectoryState) -> Array:
    """Return the change (12,) from a state to another one; see `roll.jumped`."""
    turn = (other.attitude * state.attitude.inv()).as_rotvec()
    move = other.p_Wcm - state.p_Wcm
    return np.concatenate([turn, move, other.L - state.L, other.v_Wcm - state.v_Wcm])
