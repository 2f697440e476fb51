"""Errors that are held exact: the one that explains what looks like slow noise is named."""

import numpy as np
import pytest
from scipy.signal import lfilter
from worlds.hidden_world import CRAFTS, KINDS, simulate

from cpid_drake import Spacecraft, identify
from cpid_drake.logs.log import Samples

CRAFT = CRAFTS["free_flyer"]


def identified(folder, log):
    """Identify a log with nothing stated but the sensors' noise, and all else exact."""
    file = folder / "craft.xml"
    file.write_text(CRAFT.mjcf())
    spacecraft = Spacecraft(file, base="base", capture_frame="grip")
    return identify(spacecraft, log, sensors=CRAFT.suite().exact())


@pytest.mark.parametrize(
    ("kind", "words"), [("zeros", "zeros of the joints"), ("gyro", "axes of the gyro")]
)
def test_the_error_that_explains_slow_noise_is_named(tmp_path, kind, words):
    """Truth is of MuJoCo, with joint zeros of 2 mrad, or axes of the gyro off by 1 mrad."""
    log, _ = simulate(CRAFT, KINDS[kind], 12)
    check = identified(tmp_path, log).check("errors held exact")
    assert not check.passed
    assert words in check.sentence


def test_slow_noise_is_no_error_of_the_model(tmp_path):
    """First-order Gauss-Markov noise of the gyro of 2 σ over 3 s is answered, and said.

    An error that samples do not show neither gains nor loses: so little is the largest gain.
    """
    log, truth = simulate(CRAFT, KINDS["none"], 13)
    gyro, rho = log["gyro"], np.exp(-1 / (3.0 * CRAFT.rates[1]))
    fresh = 2 * CRAFT.sigmas[2] * np.random.default_rng(1).standard_normal(gyro.value.shape)
    fresh[1:] *= np.sqrt(1 - rho**2)
    slow = lfilter([1.0], [1.0, -rho], fresh, axis=0)
    found = identified(tmp_path, log.updated({"gyro": Samples(gyro.time, gyro.value + slow)}))
    assert not found.failures
    check = found.check("errors held exact")
    assert check.passed
    assert check.statistic == pytest.approx(0, abs=0.5)
    assert any("angular velocity" in warning for warning in found.warnings)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.abs((found.parameters - truth) / sigma).max() < 4
