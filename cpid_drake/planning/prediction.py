"""The exact bound for one motion, and what the motion asks of the spacecraft."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    parameters_to_standard,
    relative_parameterization,
)
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.fitted import cramer_rao_bound
from cpid_drake.logs.log import Measurements, ideal_measurements
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import Spacecraft

_EFFORT_SAMPLES = 150
"""Number of instants at which efforts are computed."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of a motion with one target.

    Attributes:
        sigma: (10,) Cramér-Rao bound on σ of π, with all effects; NaN where not determined.
        scale: (10,) scale of each parameter.
        condition: ratio of the longest to the shortest axis of the ellipsoid of equal probability,
            in units of the scale; NaN if not all ten are determined.
        base_angle: largest turn of the base from its attitude at the start [rad].
        base_rate: its largest angular velocity [rad/s].
        base_shift: largest displacement of its origin [m].

    """

    sigma: NDArray[np.float64]
    scale: NDArray[np.float64]
    condition: float
    base_angle: float
    base_rate: float
    base_shift: float

    @property
    def worst(self) -> float:
        """Largest σ in units of the scale, of the parameters that are determined."""
        return float(np.nanmax(self.sigma / self.scale))


@dataclass(frozen=True, eq=False)
class MotionSetting:
    """What a prediction depends on besides motion and target.

    Attributes:
        spacecraft: the known spacecraft.
        suite: its sensors.
        momentum_W: (6,) total momentum [L; P] about W's origin at the start [N·m·s, N·s].
        is_unknown: whether the momentum is estimated.
        known_bodies: uncertainty of the known bodies; None if they are exact.

    """

    spacecraft: Spacecraft
    suite: SensorSuite
    momentum_W: NDArray[np.float64]
    is_unknown: bool
    known_bodies: BodyUncertainty | None

    @classmethod
    def of(cls, scenario: Scenario, spacecraft: Spacecraft, suite: SensorSuite) -> "MotionSetting":
        """Return the setting of a scenario with these sensors."""
        momentum = np.asarray(scenario.simulation.momentum_W, dtype=float)
        unknown = bool(momentum.any() or scenario.identification.unknown_momentum)
        return cls(spacecraft, suite, momentum, unknown, scenario.body_uncertainty())

    def momentum(self, target: InertialParameters, q: NDArray[np.float64]) -> TotalMomentum:
        """Return the momentum about the system's centre of mass, at joint positions q (J,)."""
        known = TotalMomentum.with_base_at_origin(self.spacecraft.tree, target, q, self.momentum_W)
        return TotalMomentum.unknown(known) if self.is_unknown else known

    def predict(self, motion: JointMotion, parameters: NDArray[np.float64]) -> Prediction:
        """Return what is expected of a motion with a target of parameters π (10,)."""
        target, tree = InertialParameters.from_vector(parameters), self.spacecraft.tree

        covariance = cramer_rao_bound(
            tree,
            relative_parameterization(tree.mass).from_parameters(parameters),
            self.ideal(motion, parameters),
            self.suite,
            momentum=self.momentum(target, motion.evaluate(0.0)[0]),
            known_bodies=self.known_bodies,
        )
        base = self.telemetry(motion, parameters, motion.instants())
        scale = parameter_scale(parameters, SCALE_LENGTH)
        axes = np.full(10, np.nan)
        if np.isfinite(covariance).all():
            axes = np.linalg.eigvalsh(covariance / scale / scale[:, None])
        cosine = np.abs(base.quaternion_WB @ base.quaternion_WB[0])
        return Prediction(
            np.sqrt(np.diag(covariance)),
            scale,
            float(np.sqrt(axes[-1] / axes[0])),
            float(2 * np.arccos(np.clip(cosine, 0, 1)).max()),
            float(np.linalg.norm(base.w_WB, axis=1).max()),
            float(np.linalg.norm(base.p_WB - base.p_WB[0], axis=1).max()),
        )

    def ideal(self, motion: JointMotion, parameters: NDArray[np.float64]) -> Measurements:
        """Return the samples that the sensors would give without errors."""
        names = self.spacecraft.joint_names

        def at(times: NDArray[np.float64]) -> Telemetry:
            return self.telemetry(motion, parameters, times)

        return ideal_measurements(self.suite, names, at, motion.duration)

    def telemetry(
        self, motion: JointMotion, parameters: NDArray[np.float64], times: NDArray[np.float64]
    ) -> Telemetry:
        """Return the motion of base and joints at times (N,) [s], with a target of π (10,)."""
        return self.telemetries(motion, parameters[None], times)[0]

    def telemetries(
        self, motion: JointMotion, targets: NDArray[np.float64], times: NDArray[np.float64]
    ) -> list[Telemetry]:
        """Return the same for each of T targets π (T, 10), at little more than the cost of one."""
        phi = np.stack([parameters_to_standard(parameters) for parameters in targets])
        tree, momentum = self.spacecraft.tree, self.momentum_W
        base = propagate(tree, motion, phi, times, momentum_W=momentum)
        names = self.spacecraft.joint_names
        return [base.to_telemetry(names, times, motion, k) for k in range(len(targets))]

    def largest_efforts(
        self, motion: JointMotion, targets: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the largest joint efforts (T, J) of a motion with T targets π [N·m or N]."""
        times = motion.instants()
        times = times[:: max(1, len(times) // _EFFORT_SAMPLES)]
        accelerations = motion.evaluate(times)[:, 2]
        return self.efforts(self.telemetries(motion, targets, times), targets, accelerations)

    def efforts(
        self,
        telemetries: list[Telemetry],
        targets: NDArray[np.float64],
        accelerations: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the largest joint efforts (T, J) with each target, in Drake's plant [N·m or N].

        Args:
            telemetries: the motion with each target, N instants each.
            targets: (T, 10) parameters π.
            accelerations: (N, J) of the joints [rad/s² or m/s²].

        """
        craft, found = self.spacecraft, []
        for telemetry, parameters in zip(telemetries, targets, strict=True):
            plant = craft.make_simulation_plant(InertialParameters.from_vector(parameters))
            dynamics, states = FreeFloatingDynamics(craft, plant), craft.to_states(telemetry)
            context = plant.CreateDefaultContext()
            found.append(np.abs(dynamics.joint_efforts(context, states, accelerations)).max(axis=0))
        return np.stack(found)
