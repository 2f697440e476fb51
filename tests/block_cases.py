"""Cases of blocks for tests: the small spacecraft of `sensing_cases` with all kinds of sensors."""

from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from sensing_cases import Sines, measured, small_craft, true_psi, true_telemetry

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block import Block, after
from cpid_drake.estimation.joints import smooth_joints
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.joint_model import JointPart
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.likelihood.motion_model import TrajectoryState
from cpid_drake.estimation.unknowns import MOMENTUM as OF_LOG
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.logs.log import Log
from cpid_drake.sensors.sensors import (
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    VectorSensor,
)
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation import trials
from cpid_drake.simulation.burns import Burn

DURATION = 4.0
ADDED = (
    replace(SENSORS["gyro"], name="gyro_2"),
    replace(SENSORS["attitude"], name="tracker_2"),
)
CONSTANT = Gyro(10.0, 0.02, 2.0)
WALKING = Gyro(20.0, 0.005, 1.0, 5.0)
MOMENTUM = np.array([3.0, -2.0, 4.0, 1.0, 0.5, -1.0])
"""Of a strong firing."""


@dataclass
class RichSuite(SensorSuite):
    """A suite with the added sensors."""

    gyro_2: Gyro | None = None
    tracker_2: AttitudeSensor | None = None


@contextmanager
def added_sensors():
    """Add a second gyro and a second star tracker to the table."""
    for sensor in ADDED:
        SENSORS[sensor.name] = sensor
    try:
        yield
    finally:
        for sensor in ADDED:
            del SENSORS[sensor.name]


def rich_suite() -> SensorSuite:
    """Return all sensors of the base, a walking and a constant gyro bias, and two trackers."""
    return RichSuite(
        attitude=AttitudeSensor(5.0, 5.0, 40.0, np.array([0.0, 0.6, 0.8])),
        gyro=WALKING,
        position=VectorSensor(5.0, 1e-3),
        velocity=VectorSensor(4.0, 1e-3),
        encoders=JointSensor(50.0, 1e-5),
        joint_rates=JointSensor(25.0, 1e-4),
        gyro_2=CONSTANT,
        tracker_2=AttitudeSensor(2.0, 20.0, 10.0, np.array([1.0, 0.2, 0.0])),
    )


@dataclass(frozen=True, eq=False)
class Case:
    """A spacecraft, its target and what its sensors measure without noise."""

    craft: object
    motion: Sines
    target: object
    suite: SensorSuite
    momentum_W: object
    samples: Log

    @property
    def psi(self):
        return true_psi(self.craft, self.target)

    def nees(self, psi, covariance) -> float:
        """Return the squared error of ψ in units of its covariance."""
        error = psi - self.psi
        return float(error @ np.linalg.solve(covariance, error))

    def block(self, start: float, end: float, samples=None) -> Block:
        samples = self.samples if samples is None else samples
        return Block(start, end, after(samples, start, end))

    def state(self, time: float) -> TrajectoryState:
        """Return the true state at a time, from the simulation in W."""
        truth = true_telemetry(
            self.craft.tree,
            self.craft.joint_names,
            self.motion,
            self.target,
            [time, time + 1.0],
            self.momentum_W,
        ).select(slice(0, 1))
        return self.state_of(truth)

    def state_of(self, truth: Motion) -> TrajectoryState:
        """Return the state of the first instant of a true motion."""
        dynamics = BodyDynamics.at(self.craft.tree, truth.q, truth.qdot)
        R, psi = truth.R_WB[0], self.psi
        w = R.T @ truth.w_WB[0]
        L = R @ (dynamics.inertia(psi)[0] @ w + dynamics.momentum_at_rest(psi)[0])
        com, rate = dynamics.com(psi)[0], dynamics.com_rate(psi)[0]
        return TrajectoryState(
            psi=psi,
            attitude=Rotation.from_matrix(R),
            p_Wcm=truth.p_WB[0] + R @ com,
            v_Wcm=truth.v_WB[0] + R @ (np.cross(w, com) + rate),
            L=L,
            constants=np.zeros(Constants.of(self.suite, len(self.craft.joint_names)).size),
        )


def joints_of(block: Block, suite: SensorSuite) -> JointPart:
    """Return the joint motion in a block by its own samples."""
    return smooth_joints([block], suite)[1][0]


def residuals_of(model: BlockModel, state: TrajectoryState) -> np.ndarray:
    """Return measured minus predicted (m,) of a block in units of σ, sensor after sensor."""
    trajectory = model.motion.trajectory(state)
    return np.concatenate([s.residuals(trajectory).ravel() for s in model.sensors.values()])


def make_case(
    folder, target, suite, momentum_W=None, duration=DURATION, gripper: bool = False
) -> Case:
    """Return a case with a motion of all joints; see `small_craft`."""
    craft = small_craft(folder, gripper=gripper)
    motion = Sines.drawn(len(craft.joint_names), seed=101, duration=duration, size=0.6)
    samples = measured(craft, motion, target, suite, momentum_W)
    return Case(craft, motion, target, suite, momentum_W, samples)


def fired(case: Case, times, momentum_W, duration=1e-6) -> Log:
    """Return what a case's sensors measure without noise if thrusters fire, which nobody logs.

    Each firing has the momentum in the world of the motion without any.
    """
    trial, tree, names = trial_of(case), case.craft.tree, case.craft.joint_names
    times = np.atleast_1d(times)
    base, burns = trials.base_trajectory(trial, tree, np.array([0.0, *times])), []
    for k, time in enumerate(times, 1):
        R_WB = Rotation.from_quat(base.quaternion_WB[k], scalar_first=True)
        torque_W = momentum_W[:3] - np.cross(base.p_WB[k], momentum_W[3:])
        parts = R_WB.inv().apply([momentum_W[3:], torque_W]) / duration
        burns.append(Burn(time, duration, force_B=parts[0], torque_B=parts[1]))
    return trials.ideal_samples(replace(trial, burns=tuple(burns), logs_thrust=False), tree, names)


def target_of(found):
    """Return ψ of a fit of one log without momentum, and its covariance."""
    [log] = found.logs
    key = f"{OF_LOG}|{log.name}"
    known = found.posterior.condition({key: -found.values[key]})
    known = known.marginal([PSI])
    return found.values[PSI] + known.solve(), known.covariance()


def trial_of(case: Case) -> trials.Case:
    """Return the inputs of a trial of a case."""
    momentum_W = np.zeros(6) if case.momentum_W is None else case.momentum_W
    return trials.Case(
        truth=case.target,
        motion=case.motion,
        duration=case.motion.duration,
        momentum_W=momentum_W,
        momentum=TotalMomentum.zero(),
        known_bodies=None,
        suite=case.suite,
        seed=0,
    )
