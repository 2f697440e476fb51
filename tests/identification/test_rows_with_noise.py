"""Least squares on rows with noise: the noise inside the rows must not show in the estimate."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake import Telemetry, TotalMomentum, identify
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import rotate

RUNS, SAMPLES, DECIMALS = 10, 4000, 2


def states(craft, target, seed) -> Telemetry:
    """Return random states of zero momentum."""
    rng, zeros = np.random.default_rng(seed), np.zeros((SAMPLES, 3))
    q, qdot = rng.uniform(-2.0, 2.0, (SAMPLES, 4)), 0.3 * rng.normal(size=(SAMPLES, 4))
    psi = standard_to_relative(target.to_standard_vector(), craft.mass)
    twist = BodyDynamics.at(craft.tree, q, qdot).base_twist(psi)
    attitude = Rotation.random(SAMPLES, rng)
    w_WB, v_WB = (rotate(attitude.as_matrix(), part) for part in twist)
    return Telemetry(
        craft.joint_names,
        np.arange(SAMPLES, dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=zeros,
        w_WB=w_WB,
        v_WB=v_WB,
        q=q,
        qdot=qdot,
    )


def test_rounded_velocities_do_not_bias_the_estimate(craft, skewed_target):
    """The mean error of several runs is no larger than their scatter explains."""
    errors = []
    for seed in range(RUNS):
        exact = states(craft, skewed_target, seed)
        rounded = replace(
            exact, w_WB=np.round(exact.w_WB, DECIMALS), v_WB=np.round(exact.v_WB, DECIMALS)
        )
        found = identify(
            craft,
            rounded,
            estimator="least_squares",
            momentum=TotalMomentum.zero(),
        )
        errors.append(found.parameters - skewed_target.to_vector())
    scatter = np.std(errors, axis=0, ddof=1) / np.sqrt(RUNS)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 5 * scatter)
