"""Plans the joint motion of a scenario that determines the target best."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion, Spline
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.errors import InputError, choose_from
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.prior import TargetPrior, load_prior
from cpid_drake.planning.base_motion import BASE_LIMITS
from cpid_drake.planning.motion_family import QUANTITIES, MotionFamily
from cpid_drake.planning.objective import Objective
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.prediction import Prediction, loads_of
from cpid_drake.planning.search import Excess, candidates, distance_excess, improved
from cpid_drake.planning.targets import plausible_targets, prior_information
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.simulation.scenario_files import load_scenario
from cpid_drake.simulation.trials import Case, make_case
from cpid_drake.spacecraft.clearance import Clearance

NODES_PER_PERIOD = 8.0
"""Nodes of the grid for each period of the highest frequency: σ is then accurate to 3 %."""

HEAVY_TARGETS = 64
"""Number of heavy targets with which a finished motion is checked: limits must hold for all."""

EXCHANGES = 6
"""Number of times that targets with which a motion exceeds limits are added: with six, few are
missed, and each time leaves enough iterations."""

BISECTIONS = 8
"""Number of shares of a motion that are checked in Drake's plant: the last differ by 1 %."""

CHECKED_IN_DRAKE = 12
"""Number of targets, those that need the most, with which a motion is checked in Drake's plant: the
order is that of a model which is accurate to 5 %."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion within all limits.

    Attributes:
        motion: of the joints.
        parameters: (F, K) of the planner's family.
        score: the criterion: the largest weighted σ in units of the scale.
        usage: the largest share of each limit that it needs with any target, by the limit's name.

    """

    motion: Spline
    parameters: Array
    score: float
    usage: dict[str, float]

    @property
    def active(self) -> list[str]:
        """The names of the limits that the motion uses to more than 97 %."""
        return [name for name, share in self.usage.items() if share > 0.97]


@dataclass(eq=False)
class Planner:
    """Plans a scenario's motion.

    The mass properties of the scenario's target are not used, only its shape.

    Args:
        scenario: spacecraft, the motion whose ends are kept, momentum, uncertainty.
        suite: the sensors, as stated.
        options: the choices of the user.
        prior: what is known about the target.
        best: the best plan so far, also after an interrupt.
        notes: what is not used or not checked, in words.

    Raises:
        InputError: a choice is not possible, or the limits leave no room for a motion.

    """

    scenario: Scenario
    suite: SensorSuite
    options: PlanOptions = field(default_factory=PlanOptions)
    prior: TargetPrior | None = None
    best: Plan | None = None
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.spacecraft = self.scenario.spacecraft.make()
        self.own_motion: JointMotion = self.scenario.make_joint_motion(self.spacecraft)
        if self.prior is None:
            self.notes.append(
                "the mass properties of the scenario's target are not used, but those of plausible "
                "targets of the spacecraft's size; --prior says what is known"
            )

    @cached_property
    def family(self) -> MotionFamily:
        """The motions: from the start to the end of the scenario's own motion, with limits."""
        options, limits, tree = self.options, self.spacecraft.limits, self.spacecraft.tree
        names, chosen, own = self.spacecraft.joint_names, options.joint or (), self.own_motion
        for name in chosen:
            if name not in names:
                raise InputError(f"no joint '{name}'; {choose_from(name, names)}")
        moving = [
            k for k, name in enumerate(names) if name in chosen or not (chosen or tree.is_rotor(k))
        ]
        if not moving:
            have = (
                "whose joints are wheels only; name one by --joint" if names else "without joints"
            )
            raise InputError(f"no motion can be planned for a spacecraft {have}")
        start, end = own.evaluate(0.0)[0], own.evaluate(own.duration)[0]
        rates = options.rate_share * limits.rates
        largest = np.stack([rates, np.full(len(names), options.acceleration)])
        bounds = np.stack([np.vstack([limits.lowest, -largest]), [limits.highest, *largest]])
        duration = options.duration or own.duration + options.opportunistic
        return MotionFamily(
            names, start, end, np.array(moving), duration, bounds, options.frequency
        )

    def case(self, motion: JointMotion, parameters: Array) -> Case:
        """Return a motion with a target of parameters π (10,), as the inputs of a trial."""
        target = InertialParameters.from_vector(parameters)
        return replace(self._own_case, truth=target, motion=motion, duration=motion.duration)

    @cached_property
    def _own_case(self) -> Case:
        """The scenario without forces, which the search does not have."""
        first = InertialParameters.from_vector(self.targets[0])
        case = make_case(self.scenario, self.spacecraft, first, self.suite, self.options.seed)
        return replace(case, burns=(), torque_W=None, acceleration_W=None)

    def predict(self, motion: JointMotion, parameters: Array) -> Prediction:
        """Return what is expected of a motion with a target of parameters π (10,)."""
        return Prediction.of(self.case(motion, parameters), self.spacecraft)

    def plausible(self, count: int, seed: int, *, heaviest: bool = False) -> Array:
        """Return π (T, 10) of plausible targets of this spacecraft; see `plausible_targets`."""
        tree, still = self.spacecraft.tree, self.family.start[None]
        inertia = BodyDynamics.at(tree, still, 0 * still).I_K[0]
        radius = float(np.sqrt(np.trace(inertia) / 2 / tree.mass))
        return plausible_targets(tree.mass, radius, count, seed, self.prior, heaviest=heaviest)

    @cached_property
    def targets(self) -> Array:
        """The targets (T, 10) that the motion is planned for."""
        return self.plausible(self.options.targets, self.options.seed)

    @cached_property
    def checked_targets(self) -> Array:
        """The targets (N, 10) with which limits must hold: these and many heavy ones."""
        heavy = self.plausible(HEAVY_TARGETS, self.options.seed + 1, heaviest=True)
        return np.concatenate([self.targets, heavy])

    @cached_property
    def clearance(self) -> Clearance | None:
        """The distances between bodies, unless the model has no geometry for them."""
        first = InertialParameters.from_vector(self.targets[0])
        try:
            clearance = Clearance(self.spacecraft, first, self.scenario.target.visual_model)
            clearance.penalties(self.family.start[None], self.options.clearance)
        except InputError as error:
            self.notes.append(f"distances are not checked: {error}")
            return None
        return clearance

    def _distances(self) -> Excess | None:
        if self.clearance is None:
            return None
        clearance, family, least = self.clearance, self.family, self.options.clearance
        return partial(distance_excess, clearance=clearance, family=family, least=least)

    @cached_property
    def objective(self) -> Objective:
        """The criterion, with weights of one and the limits for all checked targets."""
        craft, family, options = self.spacecraft, self.family, self.options
        nodes = max(int(np.ceil(NODES_PER_PERIOD * options.frequency * family.duration)), 4)
        rotation, rate = np.radians([options.base_attitude, options.base_rate]).tolist()
        limits = (rotation, rate, options.base_displacement)
        return Objective(
            Model(craft.tree, self.suite),
            self._own_case.total_momentum(craft.tree),
            family,
            np.linspace(0.0, family.duration, nodes + 1),
            self.targets,
            prior_information(self.prior),
            self.checked_targets,
            {name: x for name, x in zip(BASE_LIMITS, limits, strict=True) if np.isfinite(x)},
            craft.limits.efforts,
        )

    @one_thread
    def run(self, progress: Callable[[str, float], None] = lambda what, best: None) -> Plan:
        """Search; return the best motion that keeps all limits.

        An interrupt leaves the best motion so far in `best`. `progress` is called with the present
        step in words and the best criterion so far.

        Raises:
            InputError: no motion that is found keeps the limits.

        """
        order = self.ranked(self.options.candidates, progress)
        near, kept = self._distances(), order[:200]
        start = next((x for x in kept if near is None or near(x)[0].max() <= 0), order[0])
        candidates = [start]

        def see(parameters: Array, score: float) -> None:
            candidates.append(parameters)
            progress("gradient method", score)

        try:
            self.consider(self.improved(start, self.options.iterations, see))
        except KeyboardInterrupt:
            self.consider(candidates[-1])
            raise
        if self.best is None and self.consider(start) is None:
            raise InputError(
                "no motion keeps the constraints; allow smaller distances or more motion of the "
                "base, a longer duration, or give more --candidates"
            )
        assert self.best is not None
        return self.best

    def ranked(
        self, count: int, progress: Callable[[str, float], None] = lambda what, best: None
    ) -> Array:
        """Return random motions (count, F, K) within the limits of joints, the best first.

        They determine the weights of the targets.
        """
        drawn, sigmas = candidates(self.family, count, self.options.seed), []
        for batch in np.array_split(drawn, count // 64 + 1):
            sigmas.append(self.objective.sigmas(batch))
            progress(f"{sum(map(len, sigmas))} of {count} candidates", np.nan)
        worst, before = np.concatenate(sigmas).max(axis=2), self.objective
        self.objective = before.weighted(worst)
        scores = worst * (self.objective.weights / before.weights)
        return drawn[np.argsort(scores.max(axis=1), kind="stable")]

    def improved(
        self,
        start: Array,
        iterations: int,
        record: Callable[[Array, float], None] = lambda parameters, score: None,
    ) -> Array:
        """Return the parameters (F, K) that the gradient method makes of a start.

        Limits must hold for all checked targets. They are imposed for those that need the most and
        at least nine tenths of a limit, and further ones are added several times (exchange method,
        Blankenship and Falk 1976). The arguments are those of `search.improved`.
        """
        objective, demanding = self.objective, set[int]()
        for _ in range(EXCHANGES):
            samples = self.family.samples(start[None], objective.times)
            shares = objective.shares(samples)[0]
            chosen = shares.argmax(axis=0)[shares.max(axis=0) > 0.9]
            demanding |= set(chosen.tolist())
            imposed = replace(objective, demanding=self.checked_targets[sorted(demanding)])
            count = max(iterations // EXCHANGES, 1)
            start = improved(imposed, self._distances(), start, count, record)
        return start

    def consider(self, parameters: Array) -> Plan | None:
        """Return the plan that moves the joints as much as these parameters, or as limits allow.

        It becomes the best if its criterion is smaller. None if no share of the motion is within
        all limits.
        """
        parameters = parameters / max(1.0, self.family.usage(parameters).max())
        least, most, share, plan = 0.0, 1.0, 1.0, None
        for _ in range(BISECTIONS):
            x = share * parameters
            motion = self.family.make(x)
            usage = self.usage(motion)
            if max(usage.values()) <= 1 + 1e-9:  # a joint may rest at its limit
                plan = Plan(motion, x, float(self.objective.sigmas(x[None]).max()), usage)
                least = share
                if share == 1:
                    break
            else:
                most = share
            share = (least + most) / 2
        if plan is not None and (self.best is None or plan.score < self.best.score):
            self.best = plan
        return plan

    def usage(self, motion: JointMotion) -> dict[str, float]:
        """Return the largest share of each limit that a motion needs, by the limit's name.

        They are the largest with any of the checked targets; those of efforts are computed in
        Drake's plant, with the targets that need the most.
        """
        usage, names = dict[str, float](), self.spacecraft.joint_names
        used = self.family.usage_of(motion)
        for what, row in zip(QUANTITIES, used, strict=True):
            usage |= {f"{what} of {name}": x for name, x in zip(names, row.tolist(), strict=True)}
        shares = self.objective.shares(motion.evaluate(self.objective.times)[:, None, :2])
        most = np.argsort(shares[0].max(axis=1, initial=0.0), kind="stable")[-CHECKED_IN_DRAKE:]
        cases = [self.case(motion, target) for target in self.checked_targets[most]]
        efforts, lengths = (each.max(axis=0) for each in loads_of(cases, self.spacecraft))
        torque = efforts / self.spacecraft.limits.efforts
        usage |= {f"torque of {name}": x for name, x in zip(names, torque.tolist(), strict=True)}
        for name, length in zip(BASE_LIMITS, lengths.tolist(), strict=True):
            usage[name] = length / self.objective.limits.get(name, np.inf)
        if self.clearance is not None:
            near = self.clearance.approaches(motion.evaluate(motion.instants())[:, 0])
            least = near[0].distance if near else np.inf
            usage["distance"] = self.options.clearance / least if least > 0 else np.inf
        return usage


def load_planner(
    path: str | Path, sensors: str | None, options: PlanOptions, prior: str | Path | None = None
) -> Planner:
    """Return the planner of a scenario's file.

    Args:
        sensors: a preset or a file; None for the scenario's, else "flight".
        prior: file about the target, see `identification.prior.load_prior`; default: none.

    Raises:
        InputError: a file cannot be read; see also `Planner`.

    """
    scenario = load_scenario(path)
    own = scenario.stated_suite() if sensors is None else None
    planner = Planner(scenario, own or load_sensors(sensors or "flight"), options)
    if prior is not None:
        frame = scenario.spacecraft.capture_frame
        planner.prior = load_prior(prior, planner.spacecraft, frame)
    return planner
