"""What nobody states is in the intervals, of logs from a simulator that shares no code."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc

pytest.importorskip("mujoco", reason="needs the package mujoco")

from worlds.answers import Answer
from worlds.hidden import LABELS, PAGE, identified, table, written
from worlds.hidden_world import CRAFTS, KINDS, Hidden, simulate

from cpid_drake import BodyUncertainty
from cpid_drake.sensors.disturbances import Disturbances

SEED = 7


def test_the_page_has_every_kind_with_marginals_and_nees():
    page = PAGE.read_text(encoding="utf-8")
    assert LABELS.keys() == KINDS.keys()
    assert all(f"\n| {label} |" in page for label in LABELS.values())
    assert "| worst error | NEES: median, worst |" in page


def test_the_table_shows_what_is_wrong_together_though_right_one_by_one():
    """Of three logs, one is refused, and one has a NEES of 90 with no error beyond 2 σ."""
    errors = np.full(10, 2.0)
    group = [Answer(0, "", 8.0, 10, errors), Answer(0, "", 90.0, 10, errors), Answer(4, "no")]
    made = table({("servicer", "none"): group})
    assert "Of 3 logs, 2 are at exit 0. Of these, 0 have an error beyond 3 σ" in made
    assert "and 1 a NEES beyond 36" in made
    assert "| nothing | 2 of 3 | 2.0 σ | 49, 90 |" in made
    page = PAGE.read_text(encoding="utf-8")
    assert made in written(page, made)
    assert written(written(page, made), made) == written(page, made)


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
    log, truth = simulate(craft, Hidden(torque=2e-3), 801)
    suite = replace(craft.suite(), disturbances=Disturbances(torque_noise=0.0))
    found = identified(craft, log, truth, suite)
    assert found.code == 4
    assert "random walk" in found.said
