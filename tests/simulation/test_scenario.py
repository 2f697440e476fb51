"""Scenarios: YAML in, one line of complaint out where it cannot be built."""

import copy

import numpy as np
import pytest
import yaml
from paper.study import sampling_times

from cpid_drake import (
    MultiSine,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.files.resources import models_directory
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.simulation.joint_motions import MultiSineMotion
from cpid_drake.simulation.scenario_files import dump_scenario


@pytest.fixture(scope="module")
def paper_yaml() -> dict:
    return yaml.safe_load(shipped_scenario("paper").read_text())


@pytest.fixture
def write(tmp_path):
    """Return a function that writes text, bytes or a mapping to a scenario file."""

    def make(content):
        path = tmp_path / "scenario.yaml"
        if not isinstance(content, (str, bytes)):
            content = yaml.safe_dump(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


@pytest.fixture
def edited(paper_yaml):
    """Return a function (key path, value) -> the paper's scenario with one value changed."""

    def make(key, value):
        scenario = copy.deepcopy(paper_yaml)
        *sections, last = key.split(".")
        inner = scenario
        for section in sections:
            inner = inner[section]
        inner[last] = value
        return scenario

    return make


# -- reading -------------------------------------------------------------------------------------


# -- kinds of joint motion -----------------------------------------------------------------------

SINES = {
    "duration": 8.0,
    "ramp": 1.5,
    "frequencies": [0.1, 0.3],
    "centre": {"capture_arm_joint1": -0.4},
    "amplitudes": {"capture_arm_joint1": [0.15, 0.05], "operating_arm_joint6": [0.3, 0.0]},
    "phases": {"capture_arm_joint1": [0.5, -1.0]},
}


@pytest.fixture
def tagged(paper_yaml, write):
    """Return a function (changes of SINES, tag) -> a file of the paper's scenario with sines."""

    def make(changes, tag="!MultiSineMotion"):
        others = {key: value for key, value in paper_yaml.items() if key != "joint_motion"}
        motion = yaml.safe_dump(SINES | changes, default_flow_style=True, width=1000)
        return write(f"{yaml.safe_dump(others)}joint_motion: {tag} {motion}")

    return make


def test_sines_arrive_at_the_joints_they_are_for(tagged, servicer, tmp_path):
    scenario = load_scenario(tagged({}))
    assert isinstance(scenario.joint_motion, MultiSineMotion)
    motion = scenario.make_joint_motion(servicer)
    assert isinstance(motion, MultiSine)
    assert (motion.duration, motion.ramp) == (8.0, 1.5)
    np.testing.assert_array_equal(motion.frequencies, [0.1, 0.3])
    first, last = np.eye(12)[0], np.eye(12)[11]
    np.testing.assert_array_equal(motion.centre, -0.4 * first)
    np.testing.assert_array_equal(
        motion.amplitudes, [0.15 * first + 0.3 * last, 0.05 * first + 0.0 * last]
    )
    np.testing.assert_array_equal(motion.phases, [0.5 * first, -1.0 * first])
    make_simulation(scenario)
    text = dump_scenario(scenario)
    assert "joint_motion: !MultiSineMotion\n" in text
    (tmp_path / "again.yaml").write_text(text)
    assert repr(load_scenario(tmp_path / "again.yaml")) == repr(scenario)


def test_joints_that_a_motion_does_not_name_stand_as_the_spacecraft_is_configured(
    write, edited, tagged, servicer
):
    standing = {"capture_arm_joint1": 0.5, "operating_arm_joint6": -0.25}
    named = {"capture_arm_joint1": 0.2}
    content = edited("spacecraft.configuration", standing)
    content["joint_motion"] = {"duration": 10.0, "initial": named}
    motion = load_scenario(write(content)).make_joint_motion(servicer)
    first, last = np.eye(12)[0], np.eye(12)[11]
    np.testing.assert_array_equal(motion.q_initial, 0.2 * first - 0.25 * last)
    np.testing.assert_array_equal(motion.q_final, 0.5 * first - 0.25 * last)
    scenario = load_scenario(tagged({}))
    scenario.spacecraft.configuration = standing
    centre = scenario.make_joint_motion(servicer).centre
    np.testing.assert_array_equal(centre, -0.4 * first - 0.25 * last)


# -- sampling ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("period", "offset", "count"),
    [(0.1, 0.1, 100), (0.1, 0.0, 101), (3.0, 1.0, 4), (20.0, 10.0, 1)],
)
def test_samples_at_the_very_end_count(paper_scenario, period, offset, count):
    """Decimal periods do not lose the last sample to rounding."""
    paper_scenario.identification.period = period
    paper_scenario.identification.offset = offset
    times = sampling_times(paper_scenario)
    assert len(times) == count
    assert times[0] == offset
    assert times[-1] <= 10.0 + 1e-9


# -- sensors and uncertainty -----------------------------------------------------------------------


def test_sensors_may_be_written_into_the_scenario(write, paper_yaml):
    """Those of a preset's file, word by word, are the same sensors."""
    text = (models_directory() / "sensors" / "servicer.yaml").read_text()
    explicit = {"sensors": {"explicit": yaml.safe_load(text), "seed": 3}}
    recursive = {"identification": RECURSIVE}
    scenario = load_scenario(write(paper_yaml | explicit | recursive))
    assert repr(scenario.make_suite()) == repr(load_sensors("servicer", unstated="exact"))
    assert scenario.sensors.present
    make_simulation(scenario)


def guess(**changes) -> dict:
    inertia = np.diag([8.0, 9.0, 7.0]).tolist()
    return {"mass": 50.0, "p_CTcm_C": [0.4, 0.0, 0.0], "I_TTcm_C": inertia, "sigma": 0.3} | changes


RECURSIVE = {"estimator": "recursive_fit"}


def test_a_prior_is_what_the_recursive_fit_starts_from(write, paper_yaml):
    """Before the first sample the estimate is the prior, as sure as it says; else nothing."""
    sensors = {"sensors": {"suite": "flight"}}

    def before_the_first_sample(prior):
        identification = {"identification": RECURSIVE | {"prior": prior}}
        simulation = make_simulation(load_scenario(write(paper_yaml | sensors | identification)))
        context = simulation.diagram.CreateDefaultContext()
        identifier = simulation.identifier
        return identifier.identification(identifier.GetMyContextFromRoot(context))

    found = before_the_first_sample(guess())
    np.testing.assert_allclose(found.parameters, [50, 0.4, 0, 0, 8, 9, 7, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(found.covariance[0, 0] ** 0.5, 15.0, rtol=1e-3)
    assert not before_the_first_sample(None).is_identifiable


def test_a_suite_of_ones_own_starts_at_the_scenarios_folder(
    write, paper_yaml, tmp_path, monkeypatch
):
    (tmp_path / "mine.yaml").write_text("encoders: {rate: 20.0}\n")
    file = write(paper_yaml | {"sensors": {"suite": "mine.yaml"}})
    monkeypatch.chdir("/")
    scenario = load_scenario(file)
    assert scenario.make_suite().encoders.rate == 20.0
    uri = "package://cpid_drake_models/sensors/flight.yaml"
    assert load_scenario(write(paper_yaml | {"sensors": {"suite": uri}})).make_suite() is not None


def test_forces_of_the_simulation_are_written_and_read_without_loss(tmp_path):
    """A table, a disturbance, an orbit, a list of sprung masses and a compliant wrist."""
    text = shipped_scenario("orbit").read_text()
    text = text.replace(
        "  capture_frame: capture_point\n", "  capture_frame: capture_point\n  on_table: true\n"
    )
    mass = "{body: tank, p_BS: [0.1, 0, 0], mass: 30.0, frequency: 0.4}"
    force = "{acceleration_W: [1.0e-5, 0, 0]}"
    wrist = "{stiffness: [200, 300, 400], translational_stiffness: [1e4, 2e4, 3e4]}"
    text = text.replace(
        "simulation:\n",
        f"simulation:\n  disturbance: {force}\n  sprung_masses: [{mass}]\n  wrist: {wrist}\n",
    )
    (tmp_path / "mine.yaml").write_text(text)
    scenario = load_scenario(tmp_path / "mine.yaml")
    (tmp_path / "again.yaml").write_text(dump_scenario(scenario))
    again = load_scenario(tmp_path / "again.yaml")
    assert repr(again) == repr(scenario)
    [found] = again.simulation.sprung_masses
    assert (found.body, found.mass, found.damping_ratio) == ("tank", 30.0, 0.01)
    np.testing.assert_array_equal(found.p_BS, [0.1, 0.0, 0.0])
    np.testing.assert_array_equal(again.simulation.wrist.stiffness, [200.0, 300.0, 400.0])
    np.testing.assert_array_equal(again.simulation.wrist.damping, np.zeros(3))
    np.testing.assert_array_equal(again.simulation.wrist.translational_stiffness, [1e4, 2e4, 3e4])
    np.testing.assert_array_equal(again.simulation.disturbance.acceleration_W, [1e-5, 0, 0])
    assert again.simulation.disturbance.torque_W is None
    assert again.spacecraft.on_table
