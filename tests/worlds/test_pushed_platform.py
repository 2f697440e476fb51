"""A platform without joints that only valves push: one pressure feeds them, and one is dead."""

import json

import pytest
from scipy.special import chdtrc
from worlds.hardware_draws import identified
from worlds.pushed_platform import COMMON, DELAY, MASS, platform


def effect(draw, name):
    """Return value and σ of one error, in the unit of the result."""
    effects = json.loads(draw.urdf.with_name("found.json").read_text())["effects"]
    [found] = [each for each in effects if each["name"] == name]
    return found["value"][0], found["sigma"][0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_a_platform_is_identified_by_its_valves(tmp_path, seed):
    """All that a motion in the plane can show, without sensors of joints."""
    draw, common = platform(seed, tmp_path)
    found = identified(draw)
    assert found["code"] == 0
    assert found["named"]
    assert not found["changes"]
    assert found["known"] == 4
    assert chdtrc(4, found["nees"]) > 1e-3
    for name, true in (("common_force", 100 * common), ("valve_delay", 1e3 * DELAY)):
        value, sigma = effect(draw, f"thrusters.{name}")
        assert abs(value - true) < 3 * sigma


@pytest.mark.slow
def test_a_pressure_that_all_valves_share_does_not_average_out(tmp_path):
    """Forces tell the mass of all bodies no better than their common scale is known."""
    for declared in (True, False):  # a scale that nobody states is plausible
        draw, _ = platform(1, tmp_path / str(declared), common=declared)
        found = identified(draw)
        assert found["relative"] * draw.truth[0] / MASS > COMMON
