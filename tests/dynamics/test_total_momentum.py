"""The total momentum about the system's centre of mass and about W's origin are one."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InputError, TotalMomentum
from cpid_drake.dynamics.momentum import momentum_samples, total_momentum

MOMENTUM_W = np.array([3.0, -2.0, 2.5, 4.0, 1.0, -1.5])


def test_it_is_that_of_the_bodies(servicer, skewed_target, random_motion):
    """L_Scm is the sum over all bodies of r × m v + I ω, r and v relative to the centre of mass."""
    motion = random_motion(4, 3)
    P, L = total_momentum(servicer.tree, skewed_target, motion)
    samples = momentum_samples(servicer.tree, motion)
    mass = servicer.mass + skewed_target.mass
    p_WTcm = samples.motion.p_WC + np.einsum(
        "nij,j->ni", samples.motion.R_WC, skewed_target.p_CTcm_C
    )
    p_WScm = (servicer.mass * samples.p_WKcm + skewed_target.mass * p_WTcm) / mass
    for k in range(4):
        known = TotalMomentum.known_about_origin(np.concatenate([L[k], P[k]]), p_WScm[k], mass)
        # In the frame of the centre of mass L about it is the same, and P is zero.
        still = replace(motion.select([k]), v_WB=motion.v_WB[[k]] - known.v_WScm_W)
        P_0, L_0 = total_momentum(servicer.tree, skewed_target, still)
        np.testing.assert_allclose(P_0[0], 0, atol=1e-10)
        np.testing.assert_allclose(L_0[0], known.L_WScm_W, atol=1e-9)


@pytest.mark.parametrize("bad", [[1.0, 2.0], [np.nan, 0.0, 0.0], ["a", 0, 0], None])
def test_vectors_that_cannot_be_are_refused(bad):
    with pytest.raises(InputError, match="L_WScm_W must be 3 finite numbers"):
        TotalMomentum(bad, [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="momentum_W must be 6 finite numbers"):
        TotalMomentum.known_about_origin(bad, [0.0, 0.0, 0.0], 1.0)


def test_a_total_mass_is_positive():
    with pytest.raises(InputError, match="the total mass must be > 0 kg, not 0"):
        TotalMomentum.known_about_origin(MOMENTUM_W, np.zeros(3), 0.0)
