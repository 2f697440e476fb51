"""Joints that start and stop at different times: their acceleration steps inside of a log.

Splines cannot follow a step; what they leave must not look like flexible joints, or like changes of
the momentum, nor keep the fit from its end.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import nees

from cpid_drake import InertialParameters, identify, load_scenario, load_sensors, shipped_scenario
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import add_noise

pytestmark = pytest.mark.slow

DURATION = 10.0


@dataclass(frozen=True, eq=False)
class Turns:
    """Half a cosine of each joint in a time of its own.

    Attributes:
        middle, turn: (J,) the pose in the middle of all, and how far each joint turns [rad].
        start, length: (J,) of the turns [s].

    """

    middle: np.ndarray
    turn: np.ndarray
    start: np.ndarray
    length: np.ndarray
    duration = DURATION

    def evaluate(self, time):
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.asarray(time, dtype=float)[..., None] - self.start
        moves = (t >= 0) & (t <= self.length)
        w, half, t = np.pi / self.length, self.turn / 2, np.clip(t, 0, self.length)
        sine, cosine = np.sin(w * t), np.cos(w * t)
        parts = self.middle - half * cosine, half * w * sine, half * w**2 * cosine * moves
        return np.stack(parts, axis=-2)

    def instants(self):
        """Return times that resolve the motion [s]."""
        return np.linspace(0.0, DURATION, 401)

    def breaks(self):
        """Return times between which the motion has all derivatives [s]."""
        return np.unique(np.r_[0.0, self.start, self.start + self.length, DURATION])


def case(number, sensors):
    """Return a spacecraft with four wheels and an arm, its log and the true target."""
    rng = np.random.default_rng([2026, number])
    scenario = load_scenario(shipped_scenario("single_arm_wheels"))
    spacecraft = scenario.spacecraft.make()
    names, truth = spacecraft.joint_names, scenario.target_truth()
    length = rng.uniform(2.0, 6.0, len(names))
    turn = np.zeros(len(names))
    arm = [k for k, name in enumerate(names) if "wheel" not in name]
    turn[arm] = rng.uniform(0.4, 1.2, len(arm)) * rng.choice([-1.0, 1.0], len(arm))
    most = 0.7 * spacecraft.limits.rates * 2 * length / np.pi
    start = rng.uniform(0.0, DURATION - length)
    middle = scenario.make_joint_motion(spacecraft).evaluate(0.0)[0]
    motion = Turns(middle, np.clip(turn, -most, most), start, length)
    factor = np.exp(rng.uniform(np.log(0.5), np.log(2.0)))
    truth = InertialParameters.from_vector(factor * truth.to_vector())
    suite, moved = load_sensors(sensors), partial(spacecraft.predicted_motion, truth, motion)
    return (
        spacecraft,
        add_noise(suite, ideal_log(suite, names, moved, DURATION), number),
        truth,
        suite,
    )


@pytest.mark.parametrize(("number", "sensors"), [(4, "servicer"), (5, "testbed"), (8, "servicer")])
def test_steps_of_the_acceleration_are_no_flexible_joints(number, sensors):
    """Under the default statement, in which joints and grasp may yield."""
    spacecraft, log, truth, suite = case(number, sensors)
    found = identify(spacecraft, log, sensors=suite)
    assert found.passed, found.failures
    assert nees(found, truth) < chi2.isf(1e-3, 10)
