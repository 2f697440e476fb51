"""The exact bound for one motion, and the loads of the motion on the spacecraft."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.simulation.trials import Case, bound_of, motions_of
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
        usage: the largest share of each limit that the motion needs with any target, by name.
        errors: (N, 10) errors of the fit in N trials, in units of the scale; NaN where it failed.

    """

    sigma: Array
    plausible_sigma: Array
    scale: Array
    base_rotation: float
    base_rate: float
    base_displacement: float
    usage: dict[str, float] = field(default_factory=dict)
    errors: Array = field(default_factory=lambda: np.empty((0, 10)))

    @classmethod
    def of(cls, case: Case, spacecraft: Spacecraft) -> "Prediction":
        """Return what is expected of the motion and the target of a case."""
        stated = bound_of(replace(case, suite=case.suite.exact()), spacecraft)
        plausible = stated if case.suite.unstated == "exact" else bound_of(case, spacecraft)
        scale = parameter_scale(case.truth.to_vector(), SCALE_LENGTH)
        tree, names = spacecraft.tree, spacecraft.joint_names
        [base] = motions_of([case], tree, names, case.motion.instants())
        return cls(stated, plausible, scale, *_base_lengths(base))

    @property
    def worst(self) -> float:
        """Largest σ in units of the scale, of the parameters that are determined."""
        return float(np.nanmax(self.sigma / self.scale))

    @property
    def realised(self) -> float:
        """The largest root mean square of the errors of a parameter; NaN without trials."""
        succeeded = self.errors[np.isfinite(self.errors).all(axis=1)]
        return float(np.sqrt(np.mean(succeeded**2, axis=0)).max()) if len(succeeded) else np.nan


def loads_of(cases: Sequence[Case], spacecraft: Spacecraft) -> tuple[Array, Array]:
    """Return what the motion of T cases needs that differ as `base_trajectories` allows.

    The efforts are those of Drake's plant.

    Returns:
        The largest efforts (T, J) of the joints [N·m or N], and the largest rotation [rad],
        angular rate [rad/s] and displacement [m] of the base (T, 3).

    """
    times = cases[0].motion.instants()
    accelerations = cases[0].motion.evaluate(times)[:, 2]
    plant = MultibodyPlant(time_step=0.0)
    body = spacecraft.add_to(plant, cases[0].truth)
    dynamics = FreeFloatingDynamics(spacecraft, plant)
    context, efforts, lengths = plant.CreateDefaultContext(), [], []
    bases = motions_of(cases, spacecraft.tree, spacecraft.joint_names, times)
    for case, base in zip(cases, bases, strict=True):
        body.SetSpatialInertiaInBodyFrame(context, case.truth.to_spatial_inertia())
        needed = dynamics.joint_efforts(context, spacecraft.to_states(base), accelerations)
        efforts.append(np.abs(needed).max(axis=0))
        lengths.append(_base_lengths(base))
    return np.stack(efforts), np.array(lengths)


def _base_lengths(base: Motion) -> tuple[float, float, float]:
    """Return the largest rotation [rad], angular rate [rad/s] and displacement [m] of the base."""
    cosine = np.abs(base.quaternion_WB @ base.quaternion_WB[0])
    return (
        float(2 * np.arccos(np.clip(cosine, 0, 1)).max()),
        float(np.linalg.norm(base.w_WB, axis=1).max()),
        float(np.linalg.norm(base.p_WB - base.p_WB[0], axis=1).max()),
    )
