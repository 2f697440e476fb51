"""What a motion is planned for: the family, the plausible targets, and all constraints."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.errors import InputError, choose_from
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.planning.base_limits import BaseAttitude, BaseDisplacement, BaseLimit, BaseRate
from cpid_drake.planning.constraints import Constraint, Distances
from cpid_drake.planning.demands import Needed, TargetDemands
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.information import InformationModel
from cpid_drake.planning.limits import LimitedFamily, MotionLimits
from cpid_drake.planning.objective import Objective, PlausibleTarget
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.prediction import MotionSetting
from cpid_drake.planning.search import BATCH, Candidate, candidates
from cpid_drake.planning.targets import plausible_targets
from cpid_drake.planning.wheels import wheel_rates
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.clearance import Clearance

PLANNING_NODE_RATE = 8.0
"""Nodes of the grid for each period of the highest frequency of a motion."""

DENSE_PERIOD = 0.05
"""Time between the poses in which a finished motion's distances are checked [s]."""

WEIGHTING_MOTIONS = 256
"""Number of random motions that show how well each plausible target can be determined."""

MANY_TARGETS = 64
"""Number of heavy targets that are examined in a motion."""

_BASE_LIMITS: dict[str, type[BaseLimit]] = {
    "base_attitude": BaseAttitude,
    "base_rate": BaseRate,
    "base_displacement": BaseDisplacement,
}


@dataclass(eq=False)
class PlanProblem:
    """A scenario's motion that shall be planned.

    The mass properties of the scenario's target are not used, only its shape.

    Args:
        scenario: spacecraft, the motion whose ends are kept, momentum, uncertainty.
        suite: the sensors.
        options: the choices of the user.
        prior: what is known about the target.
        notes: what is not checked, in words.
        clearance: distances of this spacecraft with the target, if another problem has them.

    Raises:
        InputError: a choice is not possible, or the limits leave no room for a motion.

    """

    scenario: Scenario
    suite: SensorSuite
    options: PlanOptions
    prior: TargetPrior | None = None
    notes: list[str] = field(default_factory=list)
    clearance: Clearance | None = None

    def __post_init__(self) -> None:
        for name in ("targets", "candidates", "starts", "jobs"):
            if getattr(self.options, name) < 1:
                raise InputError(f"{name} must be at least 1, not {getattr(self.options, name)}")
        for name in ("rate_share", "acceleration", "frequency", "wheel_momentum", *_BASE_LIMITS):
            value = getattr(self.options, name)
            if value is not None and not value > 0:
                raise InputError(f"{name} must be > 0, not {value}")
        if not 0 <= self.options.opportunistic < np.inf:
            raise InputError(f"opportunistic must be ≥ 0, not {self.options.opportunistic}")
        self.spacecraft = self.scenario.spacecraft.make()
        self.own_motion: JointMotion = self.scenario.make_joint_motion(self.spacecraft)
        self.setting = MotionSetting.of(self.scenario, self.spacecraft, self.suite)
        self._known_needs: dict[tuple[bytes, int], Needed] = {}

    @cached_property
    def family(self) -> MotionFamily:
        """The motions: from the start to the end of the scenario's own motion."""
        names, chosen = self.spacecraft.joint_names, self.options.joints
        for name in chosen:
            if name not in names:
                raise InputError(f"no joint '{name}'; {choose_from(name, names)}")
        tree = self.spacecraft.tree
        moving = [k for k, name in enumerate(names) if name in chosen or not chosen]
        moving = [k for k in moving if chosen or not tree.is_rotor(k)]
        own = self.own_motion
        duration = self.options.duration
        if duration is None:
            duration = own.duration + self.options.opportunistic
        start, end = own.evaluate(0.0)[0], own.evaluate(own.duration)[0]
        return MotionFamily(names, start, end, np.array(moving), duration, self.options.frequency)

    @cached_property
    def limited(self) -> LimitedFamily:
        """The family with the limits of joints."""
        share, acceleration = self.options.rate_share, self.options.acceleration
        limits = MotionLimits.of_model(self.spacecraft.limits, share, acceleration)
        momentum, family = self.options.wheel_momentum, self.family
        if momentum is not None:
            moves = family.start != family.end
            moves[family.moving] = True
            tree, names = self.spacecraft.tree, family.joint_names
            largest = wheel_rates(tree, names, moves, momentum)
            limits = replace(limits, rates=np.minimum(limits.rates, largest))
        return LimitedFamily(self.family, limits)

    def plausible(
        self, count: int, seed: int, *, heaviest: bool = False
    ) -> tuple[PlausibleTarget, ...]:
        """Return targets that are plausible for this spacecraft; see `plausible_targets`."""
        tree, still = self.spacecraft.tree, self.family.start[None]
        inertia = BodyDynamics.at(tree, still, 0 * still).I_K[0]
        radius = float(np.sqrt(np.trace(inertia) / 2 / tree.mass))
        return plausible_targets(tree.mass, radius, count, seed, self.prior, heaviest=heaviest)

    @cached_property
    def objective(self) -> Objective:
        """The criterion for the plausible targets, weighted by motions within the limits."""
        craft, setting, options = self.spacecraft, self.setting, self.options
        targets = self.plausible(options.targets, options.seed)
        first = InertialParameters.from_vector(targets[0].parameters)
        model = InformationModel(
            craft.tree,
            self.suite,
            self.family.duration,
            momentum=setting.momentum(first, self.family.start),
            known_bodies=setting.known_bodies,
            node_rate=PLANNING_NODE_RATE * options.frequency,
        )
        objective = Objective(model, self.family, targets)
        if len(targets) == 1:
            return objective
        drawn = candidates(self.limited, WEIGHTING_MOTIONS, options.seed + 2)
        return objective.weighted(np.split(drawn, WEIGHTING_MOTIONS // BATCH))

    @cached_property
    def targets(self) -> tuple[NDArray[np.float64], ...]:
        """Parameters π (10,) of the plausible targets."""
        return tuple(target.parameters for target in self.objective.targets)

    @property
    def checked_targets(self) -> NDArray[np.float64]:
        """Parameters (T, 10) of the plausible targets, and of those that need the most."""
        return np.array([*self.targets, *(each.parameters for each in self.demands.targets)])

    @cached_property
    def distances(self) -> Distances | None:
        """The distances, unless the model has no geometry for them."""
        first = InertialParameters.from_vector(self.targets[0])
        try:
            self.clearance = self.clearance or Clearance(
                self.spacecraft, first, self.scenario.target.visual_model
            )
            distances = Distances(self.clearance, self.family, self.options.clearance)
            distances.evaluate(np.zeros((self.family.count, len(self.family.moving))))
        except InputError as error:
            self.notes.append(f"distances are not checked: {error}")
            return None
        return distances

    @cached_property
    def demands(self) -> TargetDemands:
        """The limits that depend on the target: of joint efforts and of the base's motion."""
        drawn = self.plausible(MANY_TARGETS, self.options.seed + 1, heaviest=True)
        many = replace(self.objective, targets=(*self.objective.targets, *drawn))
        values = {name: getattr(self.options, name) for name in _BASE_LIMITS}
        base: list[BaseLimit] = [
            _BASE_LIMITS[name](self.objective, value)
            for name, value in values.items()
            if value is not None
        ]
        return TargetDemands(self.setting, many, base)

    @property
    def constraints(self) -> list[Constraint]:
        """All constraints that are not linear."""
        return [*self.geometric, *self.demands.constraints]

    @property
    def geometric(self) -> list[Constraint]:
        """The constraints that do not depend on the target's mass properties."""
        return [] if self.distances is None else [self.distances]

    def is_kept(self, candidate: Candidate) -> bool:
        """Return whether a motion keeps all constraints at dense times, in Drake's plant."""
        if self.limited.usage(candidate.parameters).max() > 1 + 1e-3:
            return False
        distances = self.distances
        if distances is not None and not distances.is_kept(candidate.parameters, DENSE_PERIOD):
            return False
        return self.needed(candidate).largest <= 1

    def needed(self, candidate: Candidate) -> Needed:
        """Return what a candidate needs with all checked targets, as shares of the limits."""
        targets = self.checked_targets
        key = (candidate.parameters.tobytes(), len(targets))
        if key not in self._known_needs:
            self._known_needs[key] = self.demands.needed(self.motion(candidate), targets)
        return self._known_needs[key]

    def motion(self, candidate: Candidate) -> JointMotion:
        """Return a candidate's motion."""
        return self.family.make(candidate.parameters)
