"""What nobody states is not zero: stated, exact and plausible errors of sensors and craft."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import planar_craft

from cpid_drake import SensorSuite, load_sensors
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.constants import constant_errors
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.error_kinds import KINDS, bodies_of, with_plausible
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.thrusters import Thrusters, Valve

OF_BOTH = ("acceleration", "torque")


def stated(suite, tree, **options):
    """Return the sizes of all errors [SI units, rad], by name."""
    found = constant_errors(with_plausible(suite, tree, **options), 3)
    return {error.name: error.sigma for error in found}


def grown(tree, mass, length):
    """Return bodies that are heavier and larger by factors."""
    bodies = tuple(
        replace(
            body,
            mass=mass * body.mass,
            p_PF=length * body.p_PF,
            p_BBcm=length * body.p_BBcm,
            I_BBcm=mass * length**2 * body.I_BBcm,
        )
        for body in tree.bodies
    )
    return replace(tree, bodies=bodies)


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    return planar_craft(tmp_path_factory.mktemp("craft")).tree


def test_every_kind_of_a_silent_suite_has_a_size(tree):
    suite = SensorSuite(**{name: sensor.errors() for name, sensor in SENSORS.items()})
    found = stated(suite, tree)
    kinds = {name.rpartition(".")[2] for name in found}
    assert kinds == set(KINDS) - {
        *("thrust_scale", "force", "common_force", "loss", "valve_delay"),
        "joint_scale",  # the error once a turn has its slope
    }
    assert not any(name.startswith("joint_rates.") for name in found)  # those of the encoders
    forces = with_plausible(suite, tree).disturbances
    for name in (*OF_BOTH, *(f"{each}_B" for each in OF_BOTH)):
        walk, size = getattr(forces, f"{name}_walk"), getattr(forces, name)
        assert walk == pytest.approx(0.03 * size)
    assert forces.acceleration_noise is None  # no table, no thrusters
    assert forces.torque_noise is None


def test_exact_means_that_only_what_is_stated_errs(tree):
    suite = load_sensors("orbit", unstated="exact")
    names = set(stated(suite, tree, has_thrust=True))
    assert names == {
        *("attitude.mounting", "attitude.delay", "gyro.scale", "gyro.misalignment", "gyro.delay"),
        *("gyro.bias", "position.lever_arm", "position.delay", "encoders.zero"),
        *OF_BOTH,
    }
    assert bodies_of(None, suite) is None
    assert set(stated(load_sensors("orbit"), tree)) > names


def test_a_stated_size_is_kept_and_zero_is_exact(tree):
    suite = load_sensors("testbed")
    suite.position = replace(suite.position, lever_arm_mm=7.0)
    suite.gyro = replace(suite.gyro, scale_ppm=0.0)
    found = stated(suite, tree)
    assert found["position.lever_arm"] == pytest.approx(7e-3)
    assert "gyro.scale" not in found
    once = with_plausible(suite, tree)
    assert dump_yaml(with_plausible(once, tree)) == dump_yaml(once)


def test_sizes_scale_with_the_craft(tree):
    """Forces grow with the area, so that light craft are accelerated more; grasps get stiffer."""
    suite = load_sensors("testbed")
    small, heavy = (stated(suite, each) for each in (tree, grown(tree, 8.0, 2.0)))
    ratios = {name: heavy[name] / small[name] for name in small}
    assert ratios["acceleration"] == pytest.approx(1 / 2)
    assert ratios["torque"] == pytest.approx(8.0)
    assert ratios["position.lever_arm"] == pytest.approx(2.0)
    assert ratios["compliance"] == pytest.approx(1 / 8)
    assert ratios["wheel"] == pytest.approx(32.0)
    assert ratios["encoders.zero"] == ratios["gyro.scale"] == 1.0


def test_a_floor_and_valves_make_noise(tree):
    suite = load_sensors("testbed")
    table = replace(tree, normal_B=np.array([0.0, 0.0, 1.0]))
    on_table = with_plausible(suite, table).disturbances
    assert 1e-4 < on_table.acceleration_noise < 1e-2
    quiet = replace(suite, disturbances=Disturbances(acceleration_noise=0.0, torque_noise=0.0))
    assert with_plausible(quiet, table).disturbances.acceleration_noise == 0.0
    fired = replace(suite, thrusters=Thrusters({"a": Valve(force=2.0), "b": Valve(force=4.0)}))
    found = stated(fired, tree, has_thrust=True)
    assert found["a.force"] == found["b.force"] == pytest.approx(0.1)
    assert found["thrusters.common_force"] == pytest.approx(0.05)
    assert "compliance" not in found  # loads of valves change at once
    assert "attitude.delay" not in found  # the clock against which the thrust is late
    assert with_plausible(fired, tree).disturbances.torque_noise > 0


def test_bodies_are_uncertain_unless_somebody_says_that_they_are_exact():
    suite, small = load_sensors("testbed"), BodyUncertainty(mass=0.002)
    assert bodies_of(None, suite) == BodyUncertainty(mass=0.01, com=0.005, inertia=0.01)
    assert bodies_of(BodyUncertainty(), suite) is None
    assert bodies_of(small, suite) == bodies_of(small, suite.exact()) == small


def test_zeros_of_a_file_are_stated_and_what_it_leaves_out_is_not(tmp_path):
    path = tmp_path / "sensors.yaml"
    path.write_text("gyro: {scale_ppm: 0.0, delay_ms: 2, misalignment_arcsec: null}\n")
    gyro = load_sensors(path).gyro
    assert (gyro.scale_ppm, gyro.delay_ms) == (0.0, 2.0)
    assert gyro.misalignment_arcsec is gyro.clock_drift_ppm is None


@pytest.mark.parametrize("name", ["flight", "orbit", "ideal"])
def test_a_suite_is_written_and_read_without_loss(tmp_path, name):
    suite = load_sensors(name).exact()
    (tmp_path / "again.yaml").write_text(dump_yaml(suite))
    again = load_sensors(tmp_path / "again.yaml")
    assert repr(again) == repr(suite)
