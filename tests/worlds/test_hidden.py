"""What nobody states is in the intervals, of logs from a simulator that shares no code."""

from dataclasses import replace

import pytest
from scipy.special import chdtrc

pytest.importorskip("mujoco", reason="needs the package mujoco")

from worlds.hidden import identified
from worlds.hidden_world import CRAFTS, KINDS, simulate

from cpid_drake import BodyUncertainty
from cpid_drake.sensors.disturbances import Disturbances

SEED = 7


@pytest.mark.slow
@pytest.mark.parametrize("craft", CRAFTS.values(), ids=CRAFTS)
def test_a_clean_log_is_identified_to_its_noise(craft):
    """With nothing hidden and nothing unstated, the errors are as large as their covariance."""
    log, truth = simulate(craft, KINDS["none"], SEED)
    found = identified(craft, log, truth, craft.suite().exact())
    assert found.code == 0, found.said
    assert found.rank == 10
    assert chdtrc(10, found.nees) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["leak5", "gyro", "zeros", "late", "wheel", "spin", "base"])
@pytest.mark.parametrize("craft", CRAFTS.values(), ids=CRAFTS)
def test_a_hidden_error_of_a_plausible_size_is_in_the_interval(craft, kind):
    log, truth = simulate(craft, KINDS[kind], SEED)
    found = identified(craft, log, truth, craft.suite())
    assert found.code == 0, found.said
    assert found.worst < 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spin", "scale", "turn"])
def test_a_hidden_error_of_joints_or_target_shows_beside_bodies_that_are_known(kind):
    """It is in the interval, or refused: those of encoders are five times as large as plausible."""
    craft = CRAFTS["free_flyer"]
    log, truth = simulate(craft, KINDS[kind], 2)
    bodies = BodyUncertainty(mass=0.001, com=0.0005, inertia=0.002)
    found = identified(craft, log, truth, craft.suite(), bodies)
    assert found.code in ((0,) if kind == "spin" else (0, 4)), found.said
    assert found.code == 4 or (found.worst < 4 and found.nees < 40)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["joint_scale_ppm", "eccentricity_mrad"])
def test_a_stated_error_of_encoders_is_in_the_interval(key):
    """Of a belt, or of a magnetic encoder, and no other error."""
    craft = CRAFTS["free_flyer"]
    hidden = {"joint_scale_ppm": "scale", "eccentricity_mrad": "turn"}[key]
    log, truth = simulate(craft, KINDS[hidden], 2)
    suite = craft.suite().exact()
    sizes = {"joint_scale_ppm": 3000.0, "eccentricity_mrad": 4.0}
    told = replace(suite, encoders=replace(suite.encoders, **{key: sizes[key]}))
    found = identified(craft, log, truth, told)
    assert found.code == 0, found.said
    assert chdtrc(10, found.nees) > 1e-3
    untold = identified(craft, log, truth, suite)
    assert untold.code == 4 or untold.nees > 40


@pytest.mark.slow
def test_a_torque_that_changes_is_in_the_interval():
    """It changes within a block: a random walk of a plausible size is too slow for it."""
    craft = CRAFTS["free_flyer"]
    log, truth = simulate(craft, KINDS["torque"], 801)
    found = identified(craft, log, truth, craft.suite())
    assert found.code == 0, found.said
    assert found.worst < 4
    assert chdtrc(10, found.nees) > 1e-3


@pytest.mark.slow
def test_a_torque_that_walks_farther_than_stated_is_refused():
    """A white torque of zero is stated, so that nothing else can take it."""
    craft = CRAFTS["free_flyer"]
    log, truth = simulate(craft, KINDS["torque"], 801)
    suite = replace(craft.suite(), disturbances=Disturbances(torque_noise=0.0))
    found = identified(craft, log, truth, suite)
    assert found.code == 4
    assert "random walk" in found.said
