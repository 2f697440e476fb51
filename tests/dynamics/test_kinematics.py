"""Eqs. 1-3 against Drake, which computes the same by another road."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import small_craft

from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta


def test_lumping_welded_bodies_changes_no_momentum(servicer, random_motion):
    """19 bodies of which six are welded: the same momentum, centre of mass and capture point."""
    telemetry = random_motion(20, 17)
    lumped = servicer.tree.lumped
    assert sum(body.joint < 0 for body in lumped.bodies) == 1
    assert lumped.mass == pytest.approx(servicer.mass, rel=1e-15)
    assert_same_momentum(servicer.tree, lumped, telemetry.states)


def test_bodies_welded_askew_keep_their_attitude(tmp_path, skewed_target):
    """A target that is welded on a turned frame C, which is off the origin of its body."""
    craft, rng = small_craft(tmp_path), np.random.default_rng(18)
    R_BC = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
    tree = replace(craft.tree, R_BC=R_BC, p_BC=np.array([0.1, -0.2, 0.3]))
    full = tree.with_target(skewed_target.to_standard_vector())
    assert len(full.lumped.bodies) == len(full.bodies) - 1
    q, qdot = rng.normal(size=(2, 5, len(craft.joint_names)))
    w, v = rng.normal(size=(2, 5, 3))
    motion = {"q": q, "qdot": qdot, "w_WB": w, "v_WB": v}
    assert_same_momentum(full, full.lumped, motion)


def assert_same_momentum(tree, lumped, motion):
    """Momentum, centre of mass, and the motion of C."""
    results = []
    for each in (tree, lumped):
        bodies, capture = forward_kinematics(each, **motion)
        masses = np.array([body.mass for body in each.bodies])
        results.append(
            (
                *(sum(parts) for parts in momenta(each, bodies, capture.p_WC)),
                np.einsum("k,kni->ni", masses, bodies.r),
                capture.R_WC,
                capture.p_WC,
                capture.v_WC,
            )
        )
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11)
