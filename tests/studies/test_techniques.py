"""The techniques side by side: exact data give exact parameters, and each claim its verdict."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InputError, load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.joint_motion import HalfCosine
from cpid_drake.dynamics.parameterizations import STANDARD, relative_parameterization
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.sensors.sensors import Gyro
from cpid_drake.studies.techniques import network, one_joint
from cpid_drake.studies.techniques.claims import CLAIMS, OPEN, QUALIFIED, REFUTED, UPHELD, judge
from cpid_drake.studies.techniques.comparison import run_comparison
from cpid_drake.studies.techniques.extras import GENERIC
from cpid_drake.studies.techniques.force_sensors import WRENCH, load_force_sensors
from cpid_drake.studies.techniques.forgetting import (
    ForgettingLeastSquares,
    reactionless_motion,
    rows_of,
)
from cpid_drake.studies.techniques.records import techniques
from cpid_drake.studies.techniques.rows import estimate, worst_error, wrist
from cpid_drake.studies.techniques.trial import (
    draw_trial,
    exact_trial,
    require_usable,
    truth_of,
)
from cpid_drake.studies.trials import make_case

SENSORS = load_force_sensors()


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("exciting_motion"))


@pytest.fixture(scope="module")
def craft(scenario):
    return scenario.spacecraft.make()


@pytest.fixture(scope="module")
def case(scenario, craft):
    """Four seconds of the motion, a target without symmetry."""
    made = make_case(scenario, craft, GENERIC, load_sensors("flight"), (), 5)
    return replace(made, duration=4.0)


@pytest.fixture(scope="module")
def truth(case, craft):
    return truth_of(case, craft, craft.tree)


@pytest.fixture(scope="module")
def exact(case, craft, truth):
    return exact_trial(case, craft, truth, SENSORS)


@pytest.mark.parametrize(
    "technique", [t for t in techniques(SENSORS) if t.uses_rates], ids=lambda t: t.name
)
def test_exact_data_give_the_exact_target(technique, exact):
    """Also Drake's accelerations, joint torques and reactions at the grasp."""
    assert worst_error(technique.estimate(exact), GENERIC.to_vector()) < 1e-6


@pytest.mark.parametrize(
    ("name", "ranks"),
    [("wrist 0 % perfect", [6, 10, 10]), ("accelerations", [3, 6, 9, 10]), ("relative", [3, 6])],
)
def test_instants_that_suffice(name, ranks, exact):
    """Two for a wrist sensor, as the paper says of its own rows; four for accelerations."""
    if name == "relative":
        A = exact.rates
        known = BodyDynamics.at(exact.spacecraft.tree, A.motion.q, A.motion.qdot)
        rows = rows_of(known, rotate(np.swapaxes(A.motion.R_WB, 1, 2), A.motion.w_WB))[0]
    else:
        [record] = [t for t in techniques(SENSORS) if t.name == name]
        rows = record.estimate.args[0](exact)(np.zeros(10)).A[..., :10]
    chosen = rows[[60, 150, 230, 310]]
    for count, rank in enumerate(ranks, 1):
        A = chosen[:count].reshape(-1, 10)
        assert np.linalg.matrix_rank(A / np.linalg.norm(A, axis=0), tol=1e-8) == rank


def test_noise_of_a_force_sensor_that_is_not_calibrated(case, craft, truth):
    """A calibration that is estimated with its prior is better than one that is ignored."""
    trials = [draw_trial(case, craft, truth, SENSORS, k) for k in range(3)]
    errors = [
        np.mean(
            [
                worst_error(estimate(wrist(0.005, is_estimated=told), t), GENERIC.to_vector())
                for t in trials
            ]
        )
        for told in (True, False)
    ]
    assert errors[0] < 0.5 * errors[1]
    assert all(t.log.gyro.value.shape == trials[0].log.gyro.value.shape for t in trials)


def test_without_forgetting_the_recursion_is_least_squares(exact):
    motion = exact.rates.motion
    known = BodyDynamics.at(exact.spacecraft.tree, motion.q, motion.qdot)
    A, b = rows_of(known, rotate(np.swapaxes(motion.R_WB, 1, 2), motion.w_WB))
    b = b + 1e-3 * np.random.default_rng(3).standard_normal(b.shape)
    recursion = ForgettingLeastSquares(exact.spacecraft.mass, GENERIC.to_vector())
    for rows, value in zip(A, b):
        recursion.update(rows, value)
    batch = np.linalg.lstsq(A.reshape(-1, 10), b.ravel(), rcond=None)[0]
    np.testing.assert_allclose(recursion.psi, batch, rtol=1e-6)
    psi = relative_parameterization(exact.spacecraft.mass).from_parameters(GENERIC.to_vector())
    assert np.abs(recursion.psi - psi).max() > 1e-4  # the noise does something


def test_the_base_rests_while_both_arms_identify(craft, case):
    """Both arms in the null space of the estimated coupling; the same sines turn it by degrees."""
    q = case.motion.evaluate(0.0)[0]
    both = reactionless_motion(craft, GENERIC, range(12), q, duration=4.0, rate=25.0)
    free = reactionless_motion(craft, GENERIC, range(12), q, duration=4.0, rate=25.0, is_free=True)
    assert worst_error(both.parameters, GENERIC.to_vector()) < 1e-8
    assert np.degrees(both.turn) < 0.05
    assert free.turn > 50 * both.turn


def test_planar_relations_know_seven_numbers_from_three_axes(craft):
    """Their model is wrong by per cents where the base tilts; six axes tell all ten."""
    truth, found, known = GENERIC.to_vector(), {}, {}
    for axes, motion in ((3, one_joint.best_moves(craft)), (6, one_joint.six_axes(craft))):
        runs = one_joint.planar_runs(craft, GENERIC, motion)
        found[axes], known[axes] = one_joint.planar_solution(craft, runs)
    assert known == {3: 7, 6: 10}
    assert np.isfinite(found[3][:4]).all()
    assert np.isnan(found[3][4:]).all()
    assert np.isfinite(found[6]).all()
    assert 0.002 < abs(found[3][0] / truth[0] - 1) < 0.2
    assert 0.01 < worst_error(found[6], truth) < 0.2


def test_two_joints_at_a_time_are_refused(craft):
    end = np.zeros(12)
    end[[0, 3]] = 0.3
    motion = one_joint.OneAfterAnother([HalfCosine(np.zeros(12), end, 3.0)])
    runs = one_joint.planar_runs(craft, GENERIC, motion)
    with pytest.raises(InputError, match=r"one joint .* capture_arm_joint1, capture_arm_joint4"):
        one_joint.planar_solution(craft, runs)


def test_the_range_of_a_wrist_sensor_covers_the_motion(truth):
    wrench = truth.forces[WRENCH].value
    assert SENSORS.wrist_for(wrench).name == "theta"
    assert SENSORS.wrist_for(0.1 * wrench).name == "gamma"
    small = replace(SENSORS, wrists=SENSORS.wrists[:1])
    with pytest.raises(InputError, match="'gamma' is overloaded by a factor of"):
        small.wrist_for(wrench)


@pytest.mark.parametrize(
    ("suite", "change", "problem"),
    [
        ("testbed", {}, "no gyro"),
        ("flight", {"momentum_W": np.ones(6)}, "without momentum"),
    ],
)
def test_a_case_without_what_all_need_is_refused(case, craft, suite, change, problem):
    sensors = replace(load_sensors(suite), gyro=None) if suite == "testbed" else case.suite
    with pytest.raises(InputError, match=problem):
        require_usable(replace(case, suite=sensors, **change), craft, suite)


def test_a_network_learns_its_motion_and_no_other(craft, scenario):
    motion = scenario.make_joint_motion(craft)
    gyro = Gyro(100.0, angle_random_walk=0.001)
    trained = network.train(craft, motion, gyro, 10.0, targets=3000, steps=1200)
    phi = network.training_targets(100, np.random.default_rng(8))
    truth = STANDARD.to_parameters(phi)

    def median(shift):
        found = trained.parameters(network.responses(craft, motion, phi, 10.0, shift))
        return np.median([worst_error(*each) for each in zip(found, truth)])

    assert median(0.0) < 0.25  # the mean of all targets has 0.9
    assert median(0.05) > 1.5 * median(0.0)


@pytest.mark.slow
def test_a_run_judges_every_claim_from_its_own_numbers(scenario):
    """A fast run of one trial: what is not run is told as such."""
    scenario.accuracy.presets = ["flight"]
    found = run_comparison({"exciting_motion": scenario}, SENSORS, trials=1, is_fast=True)
    assert {score.problem for score in found.scores} == {""}
    fit = found.score("trajectory_fit", "exciting_motion", "flight")
    assert fit.rms < 5 * fit.bound
    assert found.error("accelerations_naive", "exciting_motion", "flight") > 100 * fit.rms
    verdicts = [judge(claim, found)[1] for claim in CLAIMS]
    assert set(verdicts) <= {UPHELD, REFUTED, QUALIFIED, OPEN}
    assert OPEN in verdicts
    assert UPHELD in verdicts
