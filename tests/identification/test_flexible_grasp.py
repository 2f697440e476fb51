"""A flexible grasp moves the base as predicted, is noticed, and is estimated if it is declared."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from cpid_drake import identify, load_scenario, make_simulation, shipped_scenario
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.estimation.likelihood.compliance import write_compliance
from cpid_drake.estimation.likelihood.effects import MotionChange
from cpid_drake.estimation.likelihood.motion import Instants
from cpid_drake.scenario.schema import WristConfig
from cpid_drake.sensing.disturbances import Disturbances

FREQUENCY = 6.0
"""Lowest natural frequency of the target on the wrist [Hz]."""


def simulated(*, is_flexible, duration=10.0, sensors=""):
    """Return a simulation, its Context at the end, and the compliance of its grasp."""
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    scenario.simulation.duration = duration
    scenario.simulation.log_period = 0.01
    scenario.sensors.suite = sensors
    scenario.identification.estimator = "least_squares"
    J = scenario.target_truth().to_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    k = (2 * np.pi * FREQUENCY) ** 2 * np.linalg.eigvalsh(J)[-1]
    if is_flexible:
        damping = 0.1 * k / (2 * np.pi * FREQUENCY)
        scenario.simulation.wrist = WristConfig(np.full(3, k), np.full(3, damping))
    simulation = make_simulation(scenario)
    return simulation, simulation.run(), 1 / k


class AtSamples:
    """The parts of a `BaseMotion` and of its trajectory that the change by compliance reads."""

    def __init__(self, tree, telemetry, psi):
        dynamics = relative_dynamics(tree, telemetry.q, telemetry.qdot)
        self.nodes = telemetry.time
        self.instants = self.grid = Instants(telemetry.time, dynamics)
        self.state, self.R = self, telemetry.R_WB
        self.psi, self.inverse = psi, dynamics.mobility(psi)
        self.w = rotate(np.swapaxes(self.R, -1, -2), telemetry.w_WB)


def test_drake_moves_the_base_as_the_first_order_predicts():
    rigid, context, _ = simulated(is_flexible=False, duration=4.0)
    expected = rigid.telemetry(context)
    flexible, context, compliance = simulated(is_flexible=True, duration=4.0)
    found = flexible.telemetry(context)
    craft, truth = rigid.spacecraft, rigid.truth
    psi = relative_parameterization(craft.mass).from_parameters(truth.to_vector())
    motion = AtSamples(craft.tree, expected, psi)
    change = MotionChange.zeros(len(expected), 3)
    write_compliance(motion, motion, compliance, change)
    w, com = change.w.sum(axis=-1), change.com.sum(axis=-1)
    turn = cumulative_simpson(rotate(motion.R, w), x=expected.time, axis=0, initial=0)
    true = Rotation.from_matrix(found.R_WB) * Rotation.from_matrix(expected.R_WB).inv()
    np.testing.assert_allclose(turn, true.as_rotvec(), atol=0.05 * np.abs(turn).max())
    rho = rotate(motion.R, motion.instants.dynamics.com(psi))
    moved = -rotate(motion.R, com) - cross(turn, rho)
    p_change = found.p_WB - expected.p_WB
    np.testing.assert_allclose(moved, p_change, atol=0.05 * np.abs(moved).max())
    rate = np.gradient(com, expected.time, axis=0)
    by_rate = change.com_rate.sum(axis=-1)
    np.testing.assert_allclose(rate[2:-2], by_rate[2:-2], atol=0.02 * np.abs(by_rate).max())


@pytest.fixture(scope="module")
def flexible():
    simulation, context, compliance = simulated(is_flexible=True, sensors="servicer")
    return simulation, simulation.measurements(context), compliance


def test_a_flexible_grasp_is_noticed(flexible):
    simulation, measurements, _ = flexible
    found = identify(simulation.spacecraft, measurements, sensors=simulation.scenario.make_suite())
    assert not found.is_trustworthy
    assert "the grasp is flexible" in found.doubts[0]
    [name, _], *_ = found.undeclared.alone
    assert name == "compliance"


def test_a_declared_compliance_is_estimated(flexible):
    """The intervals then cover the target and the compliance."""
    simulation, measurements, compliance = flexible
    suite = replace(
        simulation.scenario.make_suite(),
        disturbances=Disturbances(compliance_urad=3e6 * compliance),
    )
    found = identify(simulation.spacecraft, measurements, sensors=suite, is_final=False)
    [effect] = [each for each in found.effects if each.name == "compliance"]
    assert effect.is_learned
    assert (np.abs(effect.value - 1e6 * compliance) < 4 * effect.sigma + 2e4 * compliance).all()
    error = found.parameters - simulation.truth.to_vector()
    assert (np.abs(error) < 4 * np.sqrt(np.diag(found.covariance))).all()
