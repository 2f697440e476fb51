"""A plan of a scenario: better than the scenario's motion, within all limits, reproducible."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import (
    InertialParameters,
    InputError,
    TargetPrior,
    identify,
    load_scenario,
    load_sensors,
    shipped_scenario,
)
from cpid_drake.planning.comparison import reference_motions
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import Planner
from cpid_drake.simulation.limits import check_limits
from cpid_drake.simulation.simulation import make_simulation
from cpid_drake.simulation.trials import draw, fit_errors, make_case

ARM = [f"capture_arm_joint{k}" for k in range(1, 7)]
FLIGHT = load_sensors("flight", unstated="exact")
SMALL = PlanOptions(frequency=0.3, candidates=64, iterations=12, targets=3, joint=ARM)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("paper"))


@pytest.fixture(scope="module")
def planner(scenario):
    planner = Planner(scenario, FLIGHT, SMALL)
    planner.run()
    return planner


def parameters(planner, count, seed=3):
    drawn = np.random.default_rng(seed).normal(size=(count, *planner.family.shape))
    return drawn / planner.family.usage(drawn).max(axis=1)[:, None, None]


# -- the criterion ---------------------------------------------------------------------------------


def test_it_says_that_the_scenario_s_target_is_not_used(scenario):
    said = "the mass properties of the scenario's target are not used"
    assert any(said in note for note in Planner(scenario, FLIGHT, SMALL).notes)
    prior = TargetPrior("it", scenario.target_truth().to_vector(), np.eye(10))
    assert not any(said in note for note in Planner(scenario, FLIGHT, SMALL, prior).notes)


def test_gradients_are_those_of_central_differences(planner):
    limits = {"base attitude": 0.5, "base displacement": 0.1}
    objective = replace(planner.objective, demanding=planner.checked_targets[:2], limits=limits)
    [x], h = parameters(planner, 1), 1e-4
    values, gradient = objective.evaluate(x)
    np.testing.assert_allclose(values, objective.values(x[None])[0])
    for d in parameters(planner, 3, seed=4):
        later, before = (objective.values((x + s * h * d)[None])[0] for s in (1, -1))
        expected, found = (later - before) / (2 * h), gradient @ d.ravel()
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_what_is_known_before_adds_to_what_a_motion_teaches(planner, scenario):
    [x], truth = parameters(planner, 1), scenario.target_truth().to_vector()
    scale = planner.predict(planner.own_motion, truth).scale
    found = {}
    for sigma in (1e-7, 1e-5, 1.0):
        prior = TargetPrior("estimate", truth, np.diag((sigma * scale) ** 2))
        options = replace(SMALL, targets=1)
        following = Planner(scenario, planner.suite, options, prior)
        found[sigma] = following.objective.sigmas(x[None])[0, 0]
    np.testing.assert_allclose(found[1e-7], 1e-7, rtol=1e-2)
    assert (found[1e-5] < np.minimum(found[1.0], 1e-5)).all()
    assert found[1.0].max() > 1e-6


# -- a plan ----------------------------------------------------------------------------------------


def test_it_is_much_better_than_the_scenarios_motion_for_the_true_target(planner, scenario):
    """The planner does not know the true target."""
    truth = scenario.target_truth().to_vector()
    assert all(not np.allclose(target, truth, rtol=0.1) for target in planner.targets)
    own, plan = (
        planner.predict(motion, truth).worst for motion in (planner.own_motion, planner.best.motion)
    )
    assert own > 30 * plan


def test_it_is_better_than_all_random_motions_within_the_limits_of_joints(planner):
    random = planner.objective.sigmas(planner.ranked(SMALL.candidates)[:1]).max()
    assert planner.best.score < 0.7 * random


def test_it_keeps_the_ends_and_all_limits_of_drakes_plant(planner, scenario):
    """With the targets that it is planned for, and with others."""
    motion, own = planner.best.motion, planner.own_motion
    np.testing.assert_allclose(motion.evaluate([0.0, 10.0])[:, 0], own.evaluate([0.0, 10.0])[:, 0])
    declared = replace(scenario, joint_motion=planner.family.declare(planner.best.parameters))
    for target in (planner.targets[0], *planner.plausible(2, 99)):
        body = InertialParameters.from_vector(target)
        found = check_limits(make_simulation(declared, target=body))
        assert found.exceeded == ()
        assert found.closest
    assert max(planner.best.usage.values()) <= 1
    assert planner.best.active


@pytest.mark.slow
def test_the_same_seed_gives_the_same_plan(planner, scenario):
    again = Planner(scenario, FLIGHT, SMALL)
    np.testing.assert_array_equal(again.run().parameters, planner.best.parameters)


@pytest.mark.slow
def test_little_motion_of_the_base_can_be_required(scenario):
    limits = {"base_attitude": 60.0, "base_rate": 16.0}
    options = replace(SMALL, **limits, base_displacement=0.2, targets=1)
    planner = Planner(scenario, FLIGHT, options)
    best = planner.run()
    for target in planner.checked_targets:  # also the heaviest, which move the base most
        found = planner.predict(best.motion, target)
        assert np.degrees(found.base_rotation) <= limits["base_attitude"]
        assert np.degrees(found.base_rate) <= limits["base_rate"]
        assert found.base_displacement <= 0.2


def test_an_interrupt_leaves_a_motion_within_all_limits(scenario):
    planner = Planner(scenario, FLIGHT, SMALL)

    def interrupt(what, best):
        if what.startswith("gradient"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        planner.run(interrupt)
    assert max(planner.best.usage.values()) <= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint": ["elbow"]}, "no joint 'elbow'"),
        ({"candidates": 0}, "candidates must be > 0"),
        ({"rate_share": 0.0}, "rate_share must be > 0"),
        ({"base_displacement": -1.0}, "base_displacement must be > 0"),
        ({"duration": 4.0}, "exceeds the limit of its rate"),
        ({"duration": 12.0, "opportunistic": 1.0}, "either --duration or --opportunistic"),
        pytest.param(
            {"base_attitude": 0.05}, "no motion keeps the constraints", marks=pytest.mark.slow
        ),
    ],
)
def test_impossible_choices_are_refused(changes, message, scenario):
    with pytest.raises(InputError, match=message):
        Planner(scenario, FLIGHT, replace(SMALL, **changes)).run()


# -- comparison ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_random_and_broadband_motions_move_as_much_as_the_limits_allow(planner):
    found = dict(reference_motions(planner))
    names = ["scenario's motion", "best of 1,000 random", "multi-axis chirp"]
    assert list(found) == [*names, "random binary, smoothed"]
    for name, motion in found.items():
        usage = max(planner.usage(motion).values())
        assert name == names[0] or 0.5 < usage <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "uncertain_spacecraft"])
def test_the_errors_of_fits_are_as_large_as_predicted(name):
    """With an uncertain spacecraft its bodies are drawn, too."""
    planner = Planner(load_scenario(shipped_scenario(name)), FLIGHT)
    target, craft = planner.targets[0], planner.spacecraft
    body = InertialParameters.from_vector(target)
    case = make_case(planner.scenario, craft, body, planner.suite, 1)
    errors = np.array([*fit_errors(case, craft, 4)])
    prediction = planner.predict(planner.own_motion, target)
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / (prediction.sigma / prediction.scale)
    assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.5


def test_what_nobody_states_widens_the_prediction_as_it_widens_an_identification(scenario):
    """The world of the trial has none of these errors: only the intervals contain them."""
    stated = Planner(scenario, load_sensors("flight"))
    exact, target = Planner(scenario, FLIGHT), stated.targets[0]
    found, calibrated = (each.predict(each.own_motion, target) for each in (stated, exact))
    np.testing.assert_allclose(found.sigma, calibrated.sigma)
    np.testing.assert_array_equal(calibrated.plausible_sigma, calibrated.sigma)
    body, craft = InertialParameters.from_vector(target), stated.spacecraft
    log = draw(make_case(scenario, craft, body, FLIGHT, 1), craft, 0)
    result = identify(craft, log, sensors=stated.suite, momentum="zero")
    sigma = np.sqrt(np.diag(result.covariance))
    np.testing.assert_allclose(found.plausible_sigma, sigma, rtol=0.3)
    assert (sigma > 5 * calibrated.sigma).all()
