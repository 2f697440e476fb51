"""A spacecraft without joints, which thrusters move: nothing measures joints, and nothing must."""

from dataclasses import replace

import numpy as np
import pytest
from model_parts import joint, link, moments, urdf
from sensing_cases import Sines

from cpid_drake import InertialParameters, Spacecraft, identify, read_log
from cpid_drake.dynamics.propagation import Wrench, propagate
from cpid_drake.files.errors import InputError
from cpid_drake.identification.checked_log import check_log
from cpid_drake.logs.formats import inspect_log, write_log
from cpid_drake.logs.log import THRUST, ideal_log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, VectorSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.burns import Burn, log_of_burns

TARGET = InertialParameters(
    4.0, [0.18, -0.07, 0.12], [[0.19, 0.01, -0.03], [0.01, 0.18, 0.02], [-0.03, 0.02, 0.17]]
)
SUITE = SensorSuite(
    attitude=AttitudeSensor(20.0, 60.0, 60.0),
    position=VectorSensor(20.0, 2e-4),
    unstated="exact",
)
POINT = np.array([0.1, 0.2, -0.1])
BURNS = [
    Burn(1.0, 1.0, np.array([2.0, 0.0, 0.0]), POINT),
    Burn(3.0, 1.0, np.array([-2.0, 1.5, 0.0]), POINT),
    Burn(5.0, 1.0, np.array([0.0, -1.5, 2.0]), POINT),
    Burn(7.0, 1.0, np.array([0.0, 0.0, -2.0]), POINT),
]


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    path = tmp_path_factory.mktemp("platform") / "platform.urdf"
    base = link("base", 10.0, "", "0.02 -0.01 0.05", "0 0 0", **moments(0.25, 0.3, 0.28))
    hold = joint("hold", "base", "grip", "fixed", xyz="0.3 0.01 0.02", rpy="0 0 0.7")
    path.write_text(urdf(base, '<link name="grip"/>', hold))
    return Spacecraft(path, base="base", capture_frame="grip")


@pytest.fixture(scope="module")
def log(craft):
    return add_noise(SUITE, samples_of(craft, SUITE), 0)


def samples_of(craft, suite):
    """Return what sensors measure without noise while thrusters fire, exactly as logged."""
    thrust, still = log_of_burns(BURNS), Sines.drawn(0, 0, 9.0)

    def motion(times):
        base = propagate(
            craft.tree, still, TARGET.to_standard_vector(), times, edges=thrust.time,
            wrench=lambda time: Wrench(constant_B=thrust.held_at(time)),
        )  # fmt: skip
        return base.to_motion((), times, still)

    return ideal_log(suite, (), motion, still.duration).updated({THRUST: thrust})


@pytest.mark.parametrize(
    ("estimator", "is_declared"),
    [
        ("trajectory_fit", True),
        ("trajectory_fit", False),
        pytest.param("recursive_fit", True, marks=pytest.mark.slow),
    ],
)
def test_a_platform_is_identified_without_encoders(craft, log, estimator, is_declared):
    """Whether or not the sensors are declared; none of them measures joints."""
    suite = SUITE if is_declared else None
    found = identify(craft, log, estimator=estimator, sensors=suite)
    assert found.failures == ()
    known, truth = np.isfinite(found.parameters), TARGET.to_vector()
    assert known.all() or not is_declared
    error = (found.parameters - truth)[known] / np.sqrt(np.diag(found.covariance))[known]
    assert np.abs(error).max(initial=0.0) < 3.5
    low, high = found.shown_intervals[0]
    assert low < truth[0] < high < (1.1 if is_declared else 2.0) * truth[0]


def test_a_gap_of_the_attitude_is_none_while_a_gyro_measures(craft):
    """Nothing but the samples of the base shows a platform's motion."""
    suite = replace(SUITE, gyro=Gyro(50.0, 0.01, 1.0))
    perfect = samples_of(craft, suite)
    whole = add_noise(suite, perfect, 0)
    seen = (whole.attitude.time < 2.5) | (whole.attitude.time > 6.5)
    found, other = (
        identify(craft, each, sensors=suite)
        for each in (whole.updated({"attitude": whole.attitude.where(seen)}), whole)
    )
    assert found.failures == ()
    assert not any("gap" in text for text in found.warnings)
    sigma, least = (np.sqrt(np.diag(each.covariance)) for each in (found, other))
    assert (sigma < 1.5 * least).all()
    assert np.abs((found.parameters - TARGET.to_vector()) / sigma).max() < 3.5


def test_a_log_of_a_platform_is_written_and_read(tmp_path, log):
    """A file without columns of joints is that of a platform, if it has no other columns."""
    write_log(tmp_path / "log.csv", log)
    again = read_log(tmp_path / "log.csv")
    assert again.joint_names == ()
    np.testing.assert_array_equal(again.position.value, log.position.value)
    header, rows = (tmp_path / "log.csv").read_text().split("\n", 1)
    (tmp_path / "arm.csv").write_text(f"{header},elbow\n{rows}")
    with pytest.raises(InputError, match=r"no joint positions.*ignored columns: 'elbow'"):
        read_log(tmp_path / "arm.csv")


def test_a_file_with_joints_is_of_another_spacecraft(tmp_path, craft, log):
    write_log(tmp_path / "log.csv", log)
    header, *rows = (tmp_path / "log.csv").read_text().splitlines()
    text = "\n".join([f"{header},q:elbow", *(f"{row},0.5" for row in rows)])
    (tmp_path / "arm.csv").write_text(text)
    with pytest.raises(InputError, match=r"no joints, but the log has elbow.*ignore_joints"):
        identify(craft, tmp_path / "arm.csv")
    (tmp_path / "map.yaml").write_text("ignore_joints: [elbow]")
    found = inspect_log(tmp_path / "arm.csv", columns=tmp_path / "map.yaml", joints=())
    assert found.log.joint_names == ()


def test_a_file_of_sensors_may_have_no_encoders(tmp_path):
    """Who has joints needs them, and who has none does not."""
    path = tmp_path / "sensors.yaml"
    path.write_text("attitude: {rate: 10.0, cross_boresight_arcsec: 60.0, boresight_arcsec: 60.0}")
    assert load_sensors(path).encoders is None


def test_valves_that_open_exclude_a_check_by_momentum(craft, log):
    """What the motion shows of units cannot come from a momentum that thrusters change."""
    opening = replace(log.thrust, value=log.thrust.value.any(axis=1, keepdims=True).astype(float))
    samples = {name: s for name, s in log.samples.items() if name != THRUST}
    valves = replace(log, samples=samples | {"valve:left": opening})
    assert not check_log(craft, valves).failures
