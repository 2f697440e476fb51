"""Scenarios with what a planner needs of them."""

from dataclasses import dataclass, replace

import numpy as np

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.information import InformationModel
from cpid_drake.planning.objective import Objective, PlausibleTarget
from cpid_drake.studies.trials import Case, bound_of, ideal_samples, make_case


@dataclass(frozen=True, eq=False)
class Planned:
    """A scenario's case with sensors, its spacecraft, and the model of the information."""

    case: Case
    spacecraft: object
    model: InformationModel
    visual_model: str | None = None

    @property
    def parameters(self) -> np.ndarray:
        return self.case.truth.to_vector()

    @property
    def psi(self) -> np.ndarray:
        convert = relative_parameterization(self.spacecraft.mass)
        return convert.from_parameters(self.parameters)

    @property
    def by_psi(self) -> np.ndarray:
        return relative_parameterization(self.spacecraft.mass).jacobian(self.psi)

    def samples(self) -> np.ndarray:
        return self.case.motion.evaluate(self.model.times)[:, None, :2]

    def bound(self) -> np.ndarray:
        tree, names = self.spacecraft.tree, self.spacecraft.joint_names
        return bound_of(self.case, self.spacecraft, ideal_samples(self.case, tree, names))


def planned(name: str, preset: str, *, fine_encoders: bool = False) -> Planned:
    """Return a shipped scenario with a preset; fine encoders have no errors that matter."""
    scenario, suite = load_scenario(shipped_scenario(name)), load_sensors(preset)
    if fine_encoders:
        suite.encoders = replace(suite.encoders, bits=28, sigma=0.0)
    spacecraft = scenario.spacecraft.make()
    case = make_case(scenario, spacecraft, scenario.target_truth(), suite, (), 1)
    model = InformationModel(
        spacecraft.tree,
        suite,
        case.duration,
        momentum=case.momentum,
        known_bodies=case.known_bodies,
    )
    return Planned(case, spacecraft, model, scenario.target.visual_model)


def small_objective(
    case: Planned,
    *,
    node_rate: float | None = None,
    target: np.ndarray | None = None,
    momentum: TotalMomentum | None = None,
) -> Objective:
    """Return an objective of splines of the first four joints."""
    craft, model = case.spacecraft, case.model
    if node_rate is not None:
        model = InformationModel(
            craft.tree,
            case.case.suite,
            case.case.duration,
            momentum=momentum or TotalMomentum.zero(),
            node_rate=node_rate,
        )
    start = case.case.motion.evaluate(0.0)[0]
    family = MotionFamily(craft.joint_names, start, start, np.arange(4), case.case.duration, 0.4)
    targets = (PlausibleTarget(case.parameters if target is None else target),)
    return Objective(model, family, targets)


def check_gradient(constraint, x, h=1e-5, tolerance=1e-5) -> None:
    """Compare the gradient of a constraint at x (F, K) with differences."""
    values, gradient = constraint.evaluate(x)
    np.testing.assert_allclose(constraint.values(x), values)
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=x.shape)
        later, earlier = (constraint.values(x + s * h * d) for s in (1, -1))
        expected, found = (later - earlier) / (2 * h), gradient @ d.ravel()
        assert np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())
