"""Logs that are spoiled on purpose: no trusted interval excludes the truth, the cause is named."""

import numpy as np
import pytest
from log_cases import CASES
from log_sources import Workshop
from log_verdicts import Answer, judge
from log_words import names_cause
from scipy.spatial.transform import Rotation
from spoiled_logs import clean_summary, run_case, run_clean

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.dynamics.telemetry import Telemetry


@pytest.fixture(scope="module")
def workshop(tmp_path_factory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("spacecraft"))


NAMED = (
    *("joints_degrees_rates_too", "rates_degrees_only", "rate_sign_exact"),
    *("gyro_in_world_exact", "shuffled"),
)


@pytest.mark.parametrize("name", NAMED)
def test_a_spoiled_log_is_refused_by_name(name, workshop, tmp_path):
    [row] = run_case(name, CASES[name], workshop, tmp_path, ("default",))
    assert row.judgement.verdict == "refused", row
    assert row.judgement.is_named, row


def test_a_joint_of_another_device_is_left_out_by_name(workshop, tmp_path):
    [row] = run_case("extra_joint", CASES["extra_joint"], workshop, tmp_path, ("sensors",))
    assert row.judgement.verdict == "right", row
    assert row.judgement.is_named, row


def test_an_exact_log_is_identified(workshop, tmp_path):
    rows = list(run_clean(1, 0, workshop, tmp_path, ("default",)))
    assert rows[0].case == "arms_exact"
    assert clean_summary(rows) == {
        "runs": 1,
        "share_exit_4": 0.0,
        "share_exit_not_0": 0.0,
        "runs_FAIL": 0,
        "share_of_intervals_that_hold": 1.0,
    }


@pytest.fixture
def truth() -> InertialParameters:
    return InertialParameters(10.0, [0.1, 0.0, 0.0], np.diag([1.0, 2.0, 2.0]))


def _answer(code: int, error: np.ndarray, sigma: float, correlation: float, truth) -> Answer:
    estimate = truth.to_vector() + error
    covariance = sigma**2 * ((1 - correlation) * np.eye(10) + correlation)
    half = 1.96 * np.sqrt(np.diag(covariance))
    document = {
        "mass": estimate[0],
        "com": estimate[1:4].tolist(),
        "inertia": estimate[4:].tolist(),
        "covariance": covariance.tolist(),
        "interval_95": np.stack([estimate - half, estimate + half], axis=1).tolist(),
    }
    return Answer(code, "warning: the joint sign is wrong\nTarget in C", document)


@pytest.mark.parametrize(
    ("code", "size", "correlation", "verdict"),
    [
        (0, 2.0, 0.0, "right"),
        (0, 5.5, 0.0, "FAIL"),
        (3, 5.5, 0.0, "wrong"),
        (4, 5.5, 0.0, "untrusted"),
        (0, 4.0, 0.99, "FAIL"),  # entries that must err together err apart
    ],
)
def test_an_answer_is_judged_by_the_truth(code, size, correlation, verdict, truth):
    error = np.zeros(10)
    error[4] = 0.1 * size
    found = judge(_answer(code, error, 0.1, correlation, truth), truth, "sign")
    assert (found.verdict, found.entry, found.is_named) == (verdict, "Ixx", True)
    assert found.worst == pytest.approx(size)
    assert found.inside == 10 - (size > 1.96)


def test_refusals_and_crashes_show_nothing(truth):
    for code, verdict in ((2, "refused"), (1, "crash"), (124, "stopped")):
        found = judge(Answer(code, "cpid: error: no", {}), truth, "momentum")
        assert (found.verdict, found.known, found.is_named) == (verdict, 0, False)


def _momentum(tree, true) -> np.ndarray:
    """Return the total momentum (N, 6) of a spacecraft with the target that moves like the log."""
    m = true.ideal
    w_WB = Rotation.from_quat(m.attitude.value, scalar_first=True).apply(m.gyro.value)
    telemetry = Telemetry(
        m.joint_names,
        m.attitude.time,
        quaternion_WB=m.attitude.value,
        p_WB=m.position.value,
        w_WB=w_WB,
        v_WB=m.velocity.value,
        q=m.encoders.value,
        qdot=m.joint_rates.value,
    )
    return np.hstack(total_momentum(tree, true.case.truth, telemetry))


@pytest.mark.parametrize("name", ["payload_other_arm_exact", "bus_mass_exact", "link_length_exact"])
def test_a_log_conserves_the_momentum_of_the_true_spacecraft_only(name, workshop):
    case = CASES[name]
    true = workshop.true_log(case.source, case.motion)
    assert case.motion.tree is not None
    changed = case.motion.tree(true.spacecraft.tree)
    assert np.abs(_momentum(changed, true)).max() < 1e-9
    assert np.abs(_momentum(true.spacecraft.tree, true)).max() > 1e-3


def test_a_force_changes_the_momentum_at_a_constant_rate(workshop):
    case = CASES["force_100_mN_exact"]
    true = workshop.true_log(case.source, case.motion)
    P = _momentum(true.spacecraft.tree, true)[:, :3]
    time = true.ideal.position.time
    np.testing.assert_allclose(P, 0.1 * time[:, None] * [1.0, 0.0, 0.0], atol=1e-8)


def test_a_sentence_that_lists_every_cause_names_none():
    assert names_cause("the sign of q:joint2 seems to be wrong", r"sign.*joint2|joint2.*sign")
    every = "a sign, a clock, a frame or a unit is wrong, or forces acted"
    assert not names_cause(every, "sign")
    assert names_cause(f"{every}; the gyro is late", "late")


def test_there_are_as_many_cases_as_asked():
    assert len(CASES) > 51
