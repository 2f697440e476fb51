"""The exact bound for one motion, and the loads of the motion on the spacecraft."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    parameters_to_standard,
    relative_parameterization,
)
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.fitted import cramer_rao_bound
from cpid_drake.logs.log import ideal_log
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.schema import Scenario
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of a motion with one target, and what a fit found in trials.

    Attributes:
        sigma: (10,) Cramér-Rao bound on σ of π if only what the sensors and the spacecraft state
            has errors; NaN where not determined.
        plausible_sigma: (10,) the same if all that they do not state has plausible errors.
        scale: (10,) scale of each parameter.
        base_rotation: largest rotation of the base from its attitude at the start [rad].
        base_rate: its largest angular velocity [rad/s].
        base_displacement: largest displacement of its origin [m].
        usage: the largest share of a limit that the motion needs with any target.
        errors: (N, 10) errors of the fit in N trials, in units of the scale; NaN where it failed.

    """

    sigma: NDArray[np.float64]
    plausible_sigma: NDArray[np.float64]
    scale: NDArray[np.float64]
    base_rotation: float
    base_rate: float
    base_displacement: float
    usage: float = np.nan
    errors: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 10)))

    @property
    def worst(self) -> float:
        """Largest σ in units of the scale, of the parameters that are determined."""
        return float(np.nanmax(self.sigma / self.scale))

    @property
    def realised(self) -> float:
        """The largest root mean square of the errors of a parameter; NaN without trials."""
        succeeded = self.errors[np.isfinite(self.errors).all(axis=1)]
        return float(np.sqrt(np.mean(succeeded**2, axis=0)).max()) if len(succeeded) else np.nan


@dataclass(frozen=True, eq=False)
class MotionSetting:
    """What a prediction depends on besides motion and target.

    Attributes:
        spacecraft: the spacecraft model.
        suite: its sensors, as stated.
        momentum_W: (6,) total momentum [L; P] about W's origin at the start [N·m·s, N·s].
        is_unknown: whether the momentum is estimated.
        known_bodies: uncertainty of the spacecraft's bodies; None if they are exact.

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
        unknown = bool(momentum.any() or scenario.identification.momentum == "unknown")
        return cls(spacecraft, suite, momentum, unknown, scenario.body_uncertainty())

    def momentum(self, target: InertialParameters, q: NDArray[np.float64]) -> TotalMomentum:
        """Return the momentum about the system's centre of mass, at joint positions q (J,)."""
        known = TotalMomentum.with_base_at_origin(self.spacecraft.tree, target, q, self.momentum_W)
        return TotalMomentum.unknown(known) if self.is_unknown else known

    def predict(self, motion: JointMotion, parameters: NDArray[np.float64]) -> Prediction:
        """Return what is expected of a motion with a target of parameters π (10,)."""
        target, tree = InertialParameters.from_vector(parameters), self.spacecraft.tree

        def at(times: NDArray[np.float64]) -> Motion:
            return self.telemetries(motion, parameters[None], times)[0]

        log = ideal_log(self.suite, self.spacecraft.joint_names, at, motion.duration)

        def sigma(suite: SensorSuite) -> NDArray[np.float64]:
            covariance = cramer_rao_bound(
                tree,
                relative_parameterization(tree.mass).from_parameters(parameters),
                log,
                suite,
                momentum=self.momentum(target, motion.evaluate(0.0)[0]),
                known_bodies=self.known_bodies,
            )
            return np.sqrt(np.diag(covariance))

        stated, base = sigma(self.suite.exact()), at(motion.instants())
        plausible = stated if self.suite.unstated == "exact" else sigma(self.suite)
        scale = parameter_scale(parameters, SCALE_LENGTH)
        return Prediction(stated, plausible, scale, *_base_lengths(base))

    def telemetries(
        self, motion: JointMotion, targets: NDArray[np.float64], times: NDArray[np.float64]
    ) -> list[Motion]:
        """Return the motion at times (N,) [s] with each of T targets π (T, 10)."""
        phi = np.stack([parameters_to_standard(parameters) for parameters in targets])
        base = propagate(self.spacecraft.tree, motion, phi, times, momentum_W=self.momentum_W)
        names = self.spacecraft.joint_names
        return base.to_motions(names, times, motion)

    def needs(
        self, motion: JointMotion, targets: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what a motion needs with T targets π (T, 10), the efforts in Drake's plant.

        Returns:
            The largest efforts (T, J) of the joints [N·m or N], and the largest rotation [rad],
            angular rate [rad/s] and displacement [m] of the base (T, 3).

        """
        times = motion.instants()
        accelerations = motion.evaluate(times)[:, 2]
        bodies = [InertialParameters.from_vector(each) for each in targets]
        plant = MultibodyPlant(time_step=0.0)
        body = self.spacecraft.add_to(plant, bodies[0])
        dynamics = FreeFloatingDynamics(self.spacecraft, plant)
        context, efforts, lengths = plant.CreateDefaultContext(), [], []
        for target, telemetry in zip(bodies, self.telemetries(motion, targets, times), strict=True):
            body.SetSpatialInertiaInBodyFrame(context, target.to_spatial_inertia())
            states = self.spacecraft.to_states(telemetry)
            found = dynamics.joint_efforts(context, states, accelerations)
            efforts.append(np.abs(found).max(axis=0))
            lengths.append(_base_lengths(telemetry))
        return np.stack(efforts), np.array(lengths)


def _base_lengths(base: Motion) -> tuple[float, float, float]:
    """Return the largest rotation [rad], angular rate [rad/s] and displacement [m] of the base."""
    cosine = np.abs(base.quaternion_WB @ base.quaternion_WB[0])
    return (
        float(2 * np.arccos(np.clip(cosine, 0, 1)).max()),
        float(np.linalg.norm(base.w_WB, axis=1).max()),
        float(np.linalg.norm(base.p_WB - base.p_WB[0], axis=1).max()),
    )
