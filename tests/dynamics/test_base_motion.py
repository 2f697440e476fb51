"""The base's motion from momentum alone: the simulation without the dynamics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import (
    HalfCosine,
    InputError,
)
from cpid_drake.dynamics.base_motion import (
    base_twist,
    base_twist_sensitivity,
    known_dynamics,
    propagate_base,
)

TUMBLE = np.array([3.0, -2.0, 4.0, 1.5, -0.8, 0.6])  # [L; P] about W's origin, in W


@pytest.fixture(scope="module")
def motion(servicer):
    rng = np.random.default_rng(61)
    joints = len(servicer.joint_names)
    return HalfCosine(rng.uniform(-1, 1, joints), rng.uniform(-1, 1, joints), duration=10.0)


def test_velocities_are_the_rates_of_the_pose(servicer, skewed_target, motion):
    """By differences over 1 ms: p and v, and the attitude with ω, belong together."""
    times = np.array([0.0, 3.999, 4.0, 4.001])
    phi = skewed_target.to_standard_vector()
    base = propagate_base(servicer.tree, motion, phi, times, momentum_W=TUMBLE)
    velocity = (base.p_WB[3] - base.p_WB[1]) / 2e-3
    np.testing.assert_allclose(velocity, base.v_WB[2], atol=1e-8)
    before, after = Rotation.from_quat(base.quaternion_WB[[1, 3]], scalar_first=True)
    rate = (after * before.inv()).as_rotvec() / 2e-3
    np.testing.assert_allclose(rate, base.w_WB[2], atol=1e-8)


def test_many_targets_at_once_are_the_same_as_one_by_one(servicer, skewed_target, motion):
    rng, times = np.random.default_rng(62), np.array([0.0, 2.0, 7.0])
    phi = skewed_target.to_standard_vector() * rng.uniform(0.9, 1.1, (4, 1))
    momenta = TUMBLE * rng.uniform(0.0, 1.0, (4, 1))
    together = propagate_base(servicer.tree, motion, phi, times, momentum_W=momenta)
    for k in range(4):
        one = propagate_base(servicer.tree, motion, phi[k], times, momentum_W=momenta[k])
        for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB"):
            np.testing.assert_allclose(getattr(together, name)[k], getattr(one, name), atol=1e-13)


def test_the_error_falls_with_the_fourth_power_of_the_step(servicer, skewed_target, motion):
    phi, times = skewed_target.to_standard_vector(), np.array([0.0, 10.0])
    exact, coarse, fine = (
        propagate_base(servicer.tree, motion, phi, times, max_step=step).p_WB[1]
        for step in (0.02, 0.8, 0.4)
    )
    order = np.log2(np.linalg.norm(coarse - exact) / np.linalg.norm(fine - exact))
    assert 3.5 < order < 5.5


def test_sensitivity_is_the_derivative_by_the_parameters(servicer, skewed_target, motion):
    samples = motion.evaluate(np.linspace(1.0, 9.0, 5))
    known = known_dynamics(servicer.tree, samples[:, 0], samples[:, 1])
    phi = skewed_target.to_standard_vector()
    momentum = np.tile(TUMBLE, (5, 1))
    V = base_twist(known, phi, momentum)
    exact = base_twist_sensitivity(known, phi, V)
    for j, unit in enumerate(np.eye(10)):
        h = 1e-4
        ahead, behind = (base_twist(known, phi + s * h * unit, momentum) for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * h), exact[..., j], atol=1e-9)


@pytest.mark.parametrize(
    ("times", "step"), [([1.0, 1.0], 0.1), ([], 0.1), ([0.0, 1.0], 0.0), ([0.0, 1.0], -1.0)]
)
def test_bad_times_are_refused(servicer, skewed_target, motion, times, step):
    with pytest.raises(InputError, match=r"times must be increasing|max_step"):
        propagate_base(
            servicer.tree, motion, skewed_target.to_standard_vector(), times, max_step=step
        )
