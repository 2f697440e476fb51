"""Thrust and an orbit in the likelihood: against an integration of the momentum."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import added_sensors, joints_of, make_case, residuals_of, rich_suite, trial_of
from scipy.stats import chi2
from sensing_cases import MOMENTUM, nees, with_drawn_errors

from cpid_drake import identify
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.sensitivity import with_errors
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.logs.log import THRUST, Samples
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.simulation.burns import Burn
from cpid_drake.simulation.trials import base_trajectory, ideal_samples

START, END = 1.0, 2.5
BURNS = (
    Burn(1.313, 0.71, np.array([1.5, -2.0, 1.0]), torque_B=np.array([0.3, -0.2, 0.4])),
    Burn(1.777, 2.0, np.array([0.0, 1.0, -1.0]), torque_B=np.array([0.0, 0.3, 0.0])),
)
ORBIT = Orbit(rate=0.03, nadir_W=np.array([0.6, 0.0, -0.8]), normal_W=np.array([0.8, 0.0, 0.6]))
SCALE = 0.05


@pytest.fixture(scope="module", autouse=True)
def sensors():
    with added_sensors():
        yield


@pytest.fixture(
    scope="module",
    params=[(None, None), (MOMENTUM, None), (MOMENTUM, ORBIT)],
    ids=["at rest", "tumbling", "in orbit"],
)
def case(request, tmp_path_factory, skewed_target):
    """Sensors of the joints are exact."""
    momentum_W, orbit = request.param
    suite = replace(
        rich_suite(),
        encoders=JointSensor(50.0),
        joint_rates=None,
        disturbances=Disturbances(thrust_scale=SCALE, orbit=orbit),
    )
    case = make_case(tmp_path_factory.mktemp("craft"), skewed_target, suite, momentum_W)
    tree, names = case.craft.tree, case.craft.joint_names
    return replace(case, samples=ideal_samples(burning(case), tree, names))


def burning(case):
    return replace(trial_of(case), burns=BURNS)


def truth(case, time):
    """Return the true state at a time: momentum and pose are integrated together."""
    times = np.array([0.0, time, case.motion.duration])
    base = base_trajectory(burning(case), case.craft.tree, times)
    telemetry = base.to_motion(case.craft.joint_names, times, case.motion)
    state = case.state_of(telemetry.select(slice(1, 2)))
    return replace(state, constants=np.zeros(Constants.of(case.suite, 4).size))


def model_of(case, samples=None, tree=None, known_bodies=None):
    samples = case.block(START, END, samples).samples
    joints = joints_of(Block(START, END, samples), case.suite)
    constants = Constants.of(case.suite, len(case.craft.joint_names))
    tree = case.craft.tree if tree is None else tree
    return BlockModel(tree, joints, samples, case.suite, known_bodies, 0.0125, constants)


def test_the_predictions_are_the_simulated_readings(case):
    """Also while the thrust changes; without its log, or without the orbit, they are far off."""
    unlogged = case.samples.updated({THRUST: Samples(np.empty(0), np.empty((0, 6)))})
    assert worst_residual(case, case.samples) < 5e-3
    assert worst_residual(case, unlogged) > 5.0
    if case.suite.orbit is not None:
        nowhere = replace(case.suite, disturbances=Disturbances(thrust_scale=SCALE))
        assert worst_residual(replace(case, suite=nowhere), case.samples, truth(case, START)) > 0.5


def worst_residual(case, samples, state=None):
    """Return the largest residual [σ] of a block about the true state."""
    model = model_of(case, samples)
    return np.abs(residuals_of(model, state or truth(case, START))).max()


def test_the_end_of_a_block_is_the_true_state(case):
    model = model_of(case)
    end = model.motion.end(model.motion.trajectory(truth(case, START)))
    expected = truth(case, END)
    assert (end.attitude.inv() * expected.attitude).magnitude() < 1e-8
    for name in ("p_Wcm", "v_Wcm", "L"):
        value = getattr(end, name)
        np.testing.assert_allclose(value, getattr(expected, name), rtol=0, atol=3e-7, err_msg=name)


def test_derivatives_by_the_known_bodies(case):
    """A heavier body makes the same force accelerate the system less."""
    bodies = BodyUncertainty(mass=0.01, com=1e-3, grasp_mm=2.0)
    tree, step = case.craft.tree, 0.05
    model = model_of(case, known_bodies=bodies)
    state = truth(case, START)
    exact, _ = model.jacobian(model.motion.trajectory(state))
    place = model.columns["bodies"]
    of_mass, of_com, of_grasp = place.start, place.start + 1, place.stop - 3

    def moved(size, which):
        body = tree.bodies[0]
        if which == of_grasp:
            return with_errors(tree, BodyUncertainty(grasp_mm=2.0), np.array([size, 0, 0]))
        if which == of_mass:
            body = replace(body, mass=body.mass * (1 + 0.01 * size))
        else:
            body = replace(body, p_BBcm=body.p_BBcm + [1e-3 * size, 0, 0])
        return replace(tree, bodies=(body, *tree.bodies[1:]))

    phi = relative_parameterization(tree.mass).to_parameters(state.psi)
    for which in (of_mass, of_com, of_grasp):
        readings = []
        for size in (step, -step):
            other = moved(size, which)
            psi = relative_parameterization(other.mass).from_parameters(phi)
            changed = model_of(case, tree=other)
            readings.append(residuals_of(changed, replace(state, psi=psi)))
        column = -(readings[0] - readings[1]) / (2 * step)
        # The change of a gravity gradient with the known bodies is not in the model.
        share = 5e-3 if case.suite.orbit is None else 3e-2
        edges = np.cumsum([s.scale.size * len(s.samples) for s in model.sensors.values()])[:-1]
        parts = zip(np.split(exact[:, which], edges), np.split(column, edges), strict=True)
        for found, expected in parts:  # of each sensor
            assert np.abs(found - expected).max() < share * np.abs(expected).max()


def test_a_fit_finds_the_target(case):
    """The logged thrust is no change of momentum that has to be found."""
    suite = replace(case.suite, encoders=JointSensor(50.0, 1e-5))
    rng = np.random.default_rng(5)
    samples = with_drawn_errors(suite, case.samples, lambda _, shape: rng.standard_normal(shape))
    found = identify(case.craft, samples, sensors=suite, momentum=TotalMomentum.unknown())
    assert nees(found, case.target) < chi2.isf(1e-3, 10)
    assert found.failures == ()
    assert len(found.momentum_changes) == 0
