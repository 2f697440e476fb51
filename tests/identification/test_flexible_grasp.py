"""Flexible joints, or a flexible grasp, are estimated, declared or not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import nees

from cpid_drake import identify, load_scenario, make_simulation, shipped_scenario
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import roll
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.simulation.flexible import CompliantWrist

pytestmark = pytest.mark.slow

FREQUENCY = 6.0
"""Lowest natural frequency of the target on the wrist [Hz]."""


JOINT = 200.0
"""Compliance of all joints [µrad/(N·m)]: 5000 N·m/rad."""

STIFF = 40.0
"""The same of the motions in which a grasp is nearly rigid [Hz]."""

JOINTS = "joint_compliance"
KINDS = (JOINTS, "compliance", "translational_compliance")
FIELDS = {
    JOINTS: "joint_compliance_urad",
    "compliance": "compliance_urad",
    "translational_compliance": "translational_compliance_um",
}


def simulated(kind="", *, duration=10.0, sensors=""):
    """Return a simulation, its Context at the end, and the compliances of its grasp."""
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    scenario.simulation.duration = duration
    scenario.simulation.log_period = 0.01
    scenario.sensors.suite = sensors
    scenario.identification.estimator = "least_squares"
    truth = scenario.target_truth()
    J = truth.to_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    largest = np.linalg.eigvalsh(J)[-1]

    def spring(size, frequency):
        k = size * (2 * np.pi * frequency) ** 2
        return np.full(3, k), np.full(3, 0.1 * k / (2 * np.pi * frequency))

    compliances = dict.fromkeys(KINDS, 0.0)
    if kind == "compliance":
        wrist = CompliantWrist(*spring(largest, FREQUENCY))
    elif kind == JOINTS:  # the load on the shoulder is that of the whole arm
        scenario.simulation.joint_compliance_urad = JOINT
        compliances[kind] = 1e-6 * JOINT
    elif kind:
        wrist = CompliantWrist(*spring(largest, STIFF), *spring(truth.mass, FREQUENCY))
        compliances[kind] = 1 / wrist.translational_stiffness[0]
    if kind and kind != JOINTS:
        compliances["compliance"] = 1 / wrist.stiffness[0]
        scenario.simulation.wrist = wrist
    simulation = make_simulation(scenario)
    return simulation, simulation.run(), compliances


@pytest.fixture(scope="module", params=KINDS)
def flexible(request):
    simulation, context, compliances = simulated(request.param, sensors="servicer")
    measurements = simulation.log(context)
    return request.param, simulation, measurements, compliances[request.param]


def test_a_flexible_grasp_that_nobody_states_is_in_the_intervals(flexible):
    """With a rigid grasp the target is off by up to 10 σ."""
    _, simulation, measurements, _ = flexible
    suite = replace(simulation.scenario.make_suite(), unstated=None)
    found = identify(simulation.spacecraft, measurements, sensors=suite)
    assert found.passed
    assert nees(found, simulation.truth) < chi2.isf(1e-3, 10)


def test_a_declared_compliance_is_estimated(flexible):
    """The intervals then cover the target and the compliance."""
    kind, simulation, measurements, compliance = flexible
    suite = replace(
        simulation.scenario.make_suite(),
        disturbances=Disturbances(**{FIELDS[kind]: 3e6 * compliance}),
    )
    found = identify(simulation.spacecraft, measurements, sensors=suite)
    [effect] = [each for each in found.effects if each.name == kind]
    assert effect.is_learned
    assert (np.abs(effect.value - 1e6 * compliance) < 4 * effect.sigma + 2e4 * compliance).all()
    error = found.parameters - simulation.truth.to_vector()
    assert (np.abs(error) < 4 * np.sqrt(np.diag(found.covariance))).all()


def test_the_loads_are_those_of_the_motion_that_is_found(flexible):
    """Those of the fit are of the sweeps before; here they are computed anew."""
    _, simulation, measurements, _ = flexible
    suite = replace(simulation.scenario.make_suite(), unstated=None)
    model = Model.of(simulation.spacecraft.tree, suite)
    found = fit(model, [LogState.of(model, measurements)])
    assert found.converged
    held = found.rolled[0].all_residuals()
    anew = roll(model, found.logs[0], found.values).all_residuals()
    for name, residuals in anew.items():
        np.testing.assert_allclose(held[name], residuals, rtol=0, atol=0.05)
