"""What takes angular momentum and gives it back is found, and noise of a sensor is not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc
from worlds.hidden import identified
from worlds.hidden_world import CRAFTS, KINDS, Hidden, simulate

from cpid_drake import Spacecraft, identify
from cpid_drake.identification.oscillation_check import line_power
from cpid_drake.logs.log import Samples

CRAFT = CRAFTS["free_flyer"]


@pytest.fixture
def spacecraft(tmp_path):
    file = tmp_path / "craft.xml"
    file.write_text(CRAFT.mjcf())
    return Spacecraft(file, base="base", capture_frame="grip")


@pytest.fixture
def exact(spacecraft):
    """Return a function from a log to its result, with noise stated and all else exact."""
    return lambda log: identify(spacecraft, log, sensors=CRAFT.suite().exact())


def test_a_part_of_the_base_that_swings_fails_the_check_where_all_else_is_exact(exact):
    """Of a part of 2 % of the base on a spring in MuJoCo, the estimate is 5.8 σ off."""
    log, _ = simulate(CRAFT, KINDS["slosh"], 7003)
    check = exact(log).check("changing torque")
    assert not check.passed
    assert check.statistic > check.limit
    assert "swings" in check.sentence


def test_a_part_that_swings_is_found_by_its_frequency(exact):
    """It swings at 0.7 Hz; a log of 10 to 20 s tells frequencies apart that differ by 0.05 Hz."""
    log, _ = simulate(CRAFT, replace(KINDS["slosh"], slosh=0.04), 8201)
    check = exact(log).check("oscillation")
    assert not check.passed
    [frequency] = re.findall(r"at ([\d.]+) Hz", check.sentence)
    assert float(frequency) == pytest.approx(0.7, abs=0.05)
    assert "angular velocity" in check.sentence


@pytest.mark.parametrize(("slosh", "passed"), [(0.0, True), (0.01, False)])
def test_online_finds_by_the_changes_between_blocks_that_a_part_swings(spacecraft, slosh, passed):
    """Where errors are plausible ones; the estimate is 8 σ off if a part of 1 % swings."""
    log, _ = simulate(CRAFT, Hidden(slosh=slosh), 8102)
    online = identify(spacecraft, log, sensors=CRAFT.suite(), estimator="recursive_fit")
    assert online.check("changing torque").passed is passed


def shaken(frequency):
    """Return a log whose gyro shakes by 2 σ."""
    log, _ = simulate(CRAFT, KINDS["none"], 8201)
    gyro = log.samples["gyro"]
    error = 2 * CRAFT.sigmas[2] * np.sin(2 * np.pi * frequency * gyro.time)[:, None]
    return replace(log, samples={**log.samples, "gyro": Samples(gyro.time, gyro.value + error)})


@pytest.mark.parametrize(("frequency", "passed"), [(0.9, False), (20.0, True)])
def test_what_shakes_the_gyro_far_faster_than_the_base_moves_is_no_part_that_swings(
    exact, frequency, passed
):
    """Vibrations of wheels are in every gyro; the base moves at 0.26 Hz."""
    assert exact(shaken(frequency)).check("oscillation").passed is passed


def test_a_gap_changes_no_frequency(exact):
    """Of 19 s, 4 s are missing."""
    log = shaken(0.9)
    kept = {n: s.where((s.time < 9) | (s.time > 13)) for n, s in log.samples.items()}
    check = exact(replace(log, samples=kept)).check("oscillation")
    [frequency] = re.findall(r"at ([\d.]+) Hz", check.sentence)
    assert float(frequency) == pytest.approx(0.9, abs=0.05)


@pytest.mark.parametrize("falls_from", [3, 10])
def test_a_spectrum_that_falls_has_no_line(falls_from):
    """As that of a torque that changes slowly, or of noise that is not white; a line has 100."""
    rng, n = np.random.default_rng(1), 400
    size = 1 / np.sqrt(1 + (np.arange(n // 2 + 1) / falls_from) ** 4)[:, None]
    for _ in range(100):
        fallen = np.fft.irfft(size * np.fft.rfft(rng.standard_normal((n, 3)), axis=0), n, axis=0)
        assert line_power(fallen, 1e-9).max() < 20
    line = np.sin(2 * np.pi * 30 * np.arange(n) / n)[:, None]
    assert np.argmax(line_power(fallen + line, 1e-9)) == 29


@pytest.mark.parametrize("kind", ["none", "flicker", "half"])
def test_noise_of_sensors_is_no_torque(exact, kind):
    """White, and of half its variance slower: no torque moves what one sensor alone shows."""
    log, _ = simulate(CRAFT, KINDS[kind], 7001)
    result = exact(log)
    assert result.check("changing torque").passed
    assert result.check("oscillation").passed


def test_errors_of_integration_are_no_part_that_swings():
    """Without noise they are all that is left, far below what sensors show, and not white."""
    log, truth = simulate(CRAFT, Hidden(noise=lambda rng, shape, rate: np.zeros(shape)), 8201)
    found = identified(CRAFT, log, truth, CRAFT.suite())
    assert found.code == 0, found.said


@pytest.mark.slow
def test_online_finds_it_where_each_window_is_solved_again(spacecraft):
    """A part of 2 % leaves what looks like slow noise, which no block behind a past may have."""
    log, _ = simulate(CRAFT, KINDS["slosh"], 8102)
    online = identify(spacecraft, log, sensors=CRAFT.suite(), estimator="recursive_fit")
    assert not online.check("changing torque").passed


@pytest.mark.slow
def test_wheels_that_are_not_logged_are_in_the_interval_where_nothing_else_is_stated():
    """The fit has a white torque instead; without it, the random walks are too large."""
    log, truth = simulate(CRAFT, KINDS["wheels"], 8204)
    found = identified(CRAFT, log, truth, CRAFT.suite())
    assert found.code == 0, found.said
    assert found.worst < 4
    assert chdtrc(10, found.nees) > 1e-3
