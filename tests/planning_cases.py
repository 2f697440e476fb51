"""Scenarios with what a planner needs of them."""

from dataclasses import replace

import numpy as np

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.unknowns import Model
from cpid_drake.planning.base_motion import PlannedBaseMotion, known_instants
from cpid_drake.planning.information import covariance
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import Planner

NODE_RATE = 6.0  # [Hz]


class Planned:
    """The motion of a scenario with its true target, as a planner sees it."""

    def __init__(self, name: str, preset: str, **options) -> None:
        suite, self.scenario = load_sensors(preset), load_scenario(shipped_scenario(name))
        suite.encoders = replace(suite.encoders, bits=28, sigma=0.0)
        self.planner = Planner(self.scenario, suite, PlanOptions(**options))
        self.suite, self.spacecraft = suite, self.planner.spacecraft
        self.motion = self.planner.own_motion
        self.truth = self.scenario.target_truth()
        self.parameters = self.truth.to_vector()
        self.form = relative_parameterization(self.spacecraft.mass)
        self.psi = self.form.from_parameters(self.parameters)

    def base(self, psi=None, motion=None, momentum=None) -> PlannedBaseMotion:
        """Return the base's motion with a target of ψ; default: the scenario's momentum."""
        motion = motion or self.motion
        times = np.linspace(0.0, motion.duration, int(NODE_RATE * motion.duration) + 1)
        samples = motion.evaluate(times)[:, None, :2]
        case = self.planner.case(motion, self.parameters)
        momentum = momentum or case.total_momentum(self.spacecraft.tree)
        known = known_instants(self.spacecraft.tree, samples)
        return PlannedBaseMotion.of(times, known, momentum, self.psi if psi is None else psi)

    def sigma(self, suite=None, base=None) -> np.ndarray:
        """Return σ (10,) of π in closed form."""
        model = Model(self.spacecraft.tree, suite or self.suite)
        jacobian = self.form.jacobian(self.psi)
        [found] = covariance(model, base or self.base())
        return np.sqrt(np.diag(jacobian @ found @ jacobian.T))
