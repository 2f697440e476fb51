"""The likelihood of the samples in one block of time: residuals and their derivatives."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.plane import HELD, NORMAL_W
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.constant_effects import constant_effect
from cpid_drake.estimation.likelihood.constants import OF_GRASP, Constants
from cpid_drake.estimation.likelihood.effects import (
    Effect,
    GyroBias,
    JointErrors,
    MotionChange,
    bodies_effect,
    momentum_effect,
    start_effect,
    target_effect,
)
from cpid_drake.estimation.likelihood.joint_motion import JointPart
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory, TrajectoryState
from cpid_drake.estimation.likelihood.sensors import SensorModel, delay_of, model_classes
from cpid_drake.estimation.likelihood.white_effects import White, WhiteReading
from cpid_drake.estimation.likelihood.white_force import white_forces
from cpid_drake.logs.log import Log
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.sensors.suite import SensorSuite

STEP = 0.025
"""Longest step of the grid on which the base's attitude is integrated [s]."""


class BlockModel:
    """Predicts the samples of the base's sensors in one block of time.

    Args:
        tree: the known spacecraft.
        joints: its joint motion in the block.
        measurements: samples in the block of sensors in the suite.
        suite: the sensors' errors.
        known_bodies: uncertainty of the known bodies; None if they are exact.
        step: longest step of the grid [s].
        constants: the constant errors; default: those of the suite.
        nominal: (k,) values of the constant errors about which delays, joint zeros and thrust are
            linear, in units of their σ; default: zero.
        errors: (c,) errors of the known bodies that the tree already has, in units of their σ;
            default: zero.

    Attributes:
        motion: the base's motion.
        sensors: models of the sensors that have samples, by name.
        effects: the effects with unknowns, the target last, by name.
        columns: columns of each effect in the Jacobian; those of the known bodies are last.

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
        nominal: NDArray[np.float64] | None = None,
        errors: NDArray[np.float64] | None = None,
    ) -> None:
        present = suite.present()
        classes = {n: model for n, model in model_classes(measurements).items() if n in present}
        constants = constants or Constants.of(suite, joints.coefficients.shape[1])
        nominal = np.zeros(constants.size) if nominal is None else nominal
        delays = {name: delay_of(name, constants, nominal) for name in classes}
        needed = [
            measurements[n].time - delays[n] for n, each in classes.items() if each.at_instants
        ]
        times = np.concatenate([np.empty(0), *needed])
        thrust = thrust_log(measurements.thrust, suite.thrusters, constants, nominal)
        zeros = constants.joint_zeros(nominal)
        is_planar = tree.normal_B is not None
        white = white_forces(suite, joints.start, joints.end, is_planar)
        self.motion = BaseMotion(
            tree, joints, times, step, constants, suite.orbit, thrust, zeros, white
        )
        biases = gyro_biases(suite, joints.start, joints.end)
        self.sensors: dict[str, SensorModel | WhiteReading] = {}
        first = len(self.motion.nodes)
        for name, model in classes.items():
            count = len(measurements[name]) if model.at_instants else 0
            at = slice(first, first + count)
            samples, bias = measurements[name], biases.get(name)
            self.sensors[name] = model(name, samples, suite, self.motion, at, bias, delays[name])
            first += count
        self.sensors |= {force.name: WhiteReading(self.motion, force) for force in white}
        self.effects: list[Effect] = [start_effect(), momentum_effect(), *biases.values()]
        self.effects += [JointErrors(self.motion)]
        self.effects += [White(self.motion, force) for force in white]
        self.effects += [constant_effect(self.motion, name) for name in constants.errors]
        self.effects += [target_effect(self.motion)]
        self._everything = list(self.effects)
        if known_bodies is not None:
            self._everything.append(bodies_effect(self.motion, known_bodies, errors))
        ends = np.cumsum([0] + [effect.size for effect in self._everything]).tolist()
        names = [effect.name for effect in self._everything]
        self.columns = {name: slice(a, b) for name, (a, b) in zip(names, pairwise(ends))}
        self.at_start = self._indices(lambda effect: effect.at_start)
        self.at_end = self._indices(lambda effect: effect.at_end)

    @cached_property
    def turned(self) -> NDArray[np.intp]:
        """Columns of what depends at the end on all that turns the base: the attitude.

        In an orbit L is among them; with thrust also L, centre of mass and its velocity.
        """
        start, momentum = self.columns["start"].start, self.columns["momentum"].start
        depends = [slice(start, start + 3)]
        if self.motion.orbit is not None or self.motion.thrust is not None:
            depends.append(slice(momentum, momentum + 3))
        if self.motion.thrust is not None:
            depends += [slice(start + 3, start + 6), slice(momentum + 3, momentum + 6)]
        return np.r_[tuple(depends)]

    def _indices(self, which: Callable[[Effect], NDArray[np.intp]]) -> NDArray[np.intp]:
        parts = [self.columns[effect.name].start + which(effect) for effect in self.effects]
        return np.concatenate(parts)

    def transitions(self, trajectory: Trajectory) -> list[tuple[slice, slice, NDArray[np.float64]]]:
        """Return how centre of mass and momentum at the end depend on unknowns at the start.

        Each entry (a, b, F) is a step: the unknowns in columns b grow by F times those in columns
        a. The steps follow each other in this order.
        """
        motion, one = self.motion, np.eye(3)
        elapsed = motion.joints.end - motion.joints.start
        start, momentum = self.columns["start"], self.columns["momentum"]
        p, v = slice(start.stop - 3, start.stop), slice(momentum.stop - 3, momentum.stop)
        L = slice(momentum.start, momentum.start + 3)
        result, errors = [(v, p, elapsed * one)], motion.constants.errors
        if motion.orbit is not None:  # a symplectic matrix is the product of three such steps
            Phi = motion.orbit.transition(motion.joints.start, np.array(motion.joints.end))
            by_v, inverse = Phi[:3, 3:], np.linalg.inv(Phi[:3, 3:])
            first, last = inverse @ (Phi[:3, :3] - one), (Phi[3:, 3:] - one) @ inverse
            result = [(p, v, first), (v, p, by_v), (p, v, last)]
            by_psi = motion.gradient_by_psi(trajectory)
            assert by_psi is not None
            result.append((self.columns["psi"], L, by_psi[len(motion.nodes) - 1]))
        if "acceleration" in errors:
            a, sigma = self.columns["acceleration"], errors["acceleration"].sigma
            result += [(a, p, sigma * elapsed**2 / 2 * one), (a, v, sigma * elapsed * one)]
        to = {"p": p, "v": v, "L": L}
        result += [
            (self.columns[force.name], to[name], by)
            for force in motion.white
            for name, by in force.transitions().items()
        ]
        if "torque" in errors:
            result.append((self.columns["torque"], L, errors["torque"].sigma * elapsed * one))
        return result

    def jacobian(self, trajectory: Trajectory) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the derivatives (m, n) of the predictions in units of σ, and those of `turned`.

        The latter (3, n), (6, n) or (12, n) are at the block's end: rotations in W; in an orbit the
        part of L that comes by the attitude; with thrust the parts of L, centre of mass and
        velocity that come by the thrust; `transitions` has the rest. The columns are `columns`,
        known bodies included.
        """
        n, constants = self._width, self.motion.constants
        change = self._no_change(n)
        for effect in self._everything:
            effect.change_motion(trajectory, change.columns(self.columns[effect.name]))
        readings, last = self._response(trajectory, change)
        if len(last) > 3:
            last[3:, self.turned[3:]] += np.eye(len(last) - 3)
        parts = [np.empty((0, n))]
        for name, sensor in self.sensors.items():
            rows = readings[name]
            for constant, by in sensor.by_constants(trajectory).items():
                rows[:, :, self.columns[constant]] += by * constants.errors[constant].sigma
            for effect in self.effects:
                part = rows[:, :, self.columns[effect.name]]
                effect.change_reading(name, sensor.samples.time, part)
            if isinstance(sensor, WhiteReading):
                rows[:, :, self.columns["psi"]] += sensor.by_target(trajectory)
            parts.append(sensor.whitened(rows).reshape(-1, n))
        return self._in_plane(np.vstack(parts), last)

    def bent(
        self, trajectory: Trajectory
    ) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.float64]]:
        """Return what a flexible grasp adds to the readings and to the state at the block's end.

        The trajectory is that of a rigid grasp; the effect is of first order in the compliance.

        Returns:
            (M, d) in units of σ, by sensor, and (12,) change of attitude, centre of mass, L and v.
            Nothing and zero without such a grasp.

        """
        flexible = [effect for effect in self.effects if effect.name in OF_GRASP]
        readings, end = dict[str, NDArray[np.float64]](), np.zeros(12)
        if not flexible:
            return readings, end
        constants = self.motion.constants
        change = self._no_change(1)
        for effect in flexible:
            each = self._no_change(effect.size)
            effect.change_motion(trajectory, each)
            value = trajectory.state.constants[constants.place(effect.name)]
            for name in ("w", "com", "com_rate"):
                getattr(change, name)[..., 0] += getattr(each, name) @ value
        rows, last = self._response(trajectory, change)
        readings = {n: self.sensors[n].whitened(part)[..., 0] for n, part in rows.items()}
        if self.motion.tree.normal_B is not None:
            last[:3] *= NORMAL_W[:, None]
        end[: len(last)] = last[:, 0]
        return readings, end[np.r_[0:3, 6:9, 3:6, 9:12]]

    def _no_change(self, n: int) -> MotionChange:
        motion = self.motion
        instants, of_thrust = len(motion.times), len(motion.constants.of_thrust)
        change = MotionChange.zeros(instants, n, of_thrust)
        if not motion.white:
            return change
        position, velocity = np.zeros((2, instants, 3, n))
        return replace(change, position=position, velocity=velocity)

    def _response(
        self, trajectory: Trajectory, change: MotionChange
    ) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.float64]]:
        """Return what a change of the motion changes in the readings, and in `turned`.

        The readings (M, 3, n) are in SI units, by sensor. The change gets that of the attitude.
        """
        N = len(self.motion.nodes)
        direct = self._change_by_thrust(trajectory, change)
        ends, change.w[:N] = self.motion.pose_change(trajectory, change.w[:N], change.attitude)
        xi, last = ends[:, :3], ends[-1].copy()  # a view would keep all of it
        if direct is not None:
            change, pushed = self._pushed(trajectory, change, xi)
            last[3:] += direct[N - 1]
            last = np.concatenate([last, pushed])
        rows = {n: s.jacobian(trajectory, change, xi) for n, s in self.sensors.items()}
        return rows, last

    def _change_by_thrust(
        self, trajectory: Trajectory, change: MotionChange
    ) -> NDArray[np.float64] | None:
        """Add to `change.w` what comes by the thrust at unchanged attitude.

        Returns:
            The change (U, 3, n) of L by the thrust, in W; None without thrust.

        """
        thrust, state, N = self.motion.thrust, trajectory.state, len(self.motion.nodes)
        if thrust is None:
            return None
        by = thrust.momentum_change(trajectory.R[:N], state.psi, change.com[:N], change.thrust)
        change.w[:] += trajectory.inverse @ np.swapaxes(trajectory.R, -1, -2) @ by
        return by

    def _pushed(
        self, trajectory: Trajectory, change: MotionChange, xi: NDArray[np.float64]
    ) -> tuple[MotionChange, NDArray[np.float64]]:
        """Return the change with that of the travel by thrust, and the rows (6, n) of `turned`."""
        thrust, state, N = self.motion.thrust, trajectory.state, len(self.motion.nodes)
        assert thrust is not None
        travel, rows = thrust.travel_change(
            trajectory.R[:N],
            state.psi,
            xi,
            change.inverse_mass,
            change.thrust,
        )
        position, velocity = travel[:, :3], travel[:, 3:]
        if change.position is not None and change.velocity is not None:
            position, velocity = position + change.position, velocity + change.velocity
        return replace(change, position=position, velocity=velocity), rows

    def _in_plane(
        self, rows: NDArray[np.float64], turn: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return both without what a table holds: tilt, height, and the momentum out of the plane.

        These derivatives are zero up to rounding. Rounding errors would grow from block to block,
        because nothing else determines these quantities.
        """
        held = self.held
        if not held.size:
            return rows, turn
        rows[:, held] = turn[:, held] = 0.0
        turn[:3] *= NORMAL_W[:, None]
        fixed = np.flatnonzero(np.isin(self.turned, held))
        turn[fixed] = 0.0
        turn[fixed, self.turned[fixed]] = 1.0
        return rows, turn

    def scale_of(self, name: str) -> NDArray[np.float64]:
        """Return σ (d,) of the components of a sensor's samples [SI units]."""
        sensor = self.sensors[name]
        return sensor.scale if isinstance(sensor, SensorModel) else np.ones(1)

    @property
    def held(self) -> NDArray[np.intp]:
        """Columns of the quantities that a table holds; none without a table."""
        if self.motion.tree.normal_B is None:
            return np.empty(0, dtype=np.intp)
        start, momentum = self.columns["start"].start, self.columns["momentum"].start
        firsts = {"attitude": start, "p_Wcm": start + 3, "L": momentum, "v_Wcm": momentum + 3}
        firsts |= {name: place.start for name, place in self.columns.items()}
        places = [firsts[name] + np.array(HELD[name]) for name in HELD.keys() & firsts.keys()]
        return np.concatenate(places)

    def links(self, state: TrajectoryState) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rows [A | b] of all effects that connect quantities of this block."""
        parts, rest = [np.zeros((0, self._width))], [np.empty(0)]
        for effect in self.effects:
            A, b = effect.links(state)
            rows = np.zeros((len(b), self._width))
            rows[:, self.columns[effect.name]] = A
            parts.append(rows)
            rest.append(b)
        return np.vstack(parts), np.concatenate(rest)

    @property
    def _width(self) -> int:
        return sum(effect.size for effect in self._everything)


def gyro_biases(suite: SensorSuite, start: float, end: float) -> dict[str, GyroBias]:
    """Return the biases of all gyros of a suite in a block, by the gyros' names."""
    biases: dict[str, GyroBias] = {}
    first = 0
    for name, errors in suite.present().items():
        if isinstance(errors, Gyro):
            biases[name] = GyroBias(name, errors, first, start, end)
            first += biases[name].nodes
    return biases
