"""Two halves of smoothed samples have the same target, unless the world is not as modelled."""

from dataclasses import replace

import pytest
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake import identify
from cpid_drake.logs.simulated_noise import add_noise


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()


@pytest.fixture(scope="module")
def ideal(craft, suite, skewed_target):
    """Returns samples without noise of a true spacecraft whose base is heavier by a factor."""

    def samples(heavier=1.0):
        tree = craft.tree
        base, *others = tree.bodies
        base = replace(base, mass=heavier * base.mass, I_BBcm=heavier * base.I_BBcm)
        motion = Sines.drawn(4, seed=101, duration=12.0, size=0.6)
        true = replace(tree, bodies=(base, *others))
        return measured(craft, motion, skewed_target, suite, tree=true)

    return samples


@pytest.mark.parametrize("sensors", ["given", pytest.param("estimated", marks=pytest.mark.slow)])
def test_a_base_heavier_than_its_model_is_doubted(craft, suite, ideal, sensors):
    given = suite if sensors == "given" else None

    def failures(heavier):
        samples = add_noise(suite, ideal(heavier), seed=3)
        found = identify(craft, samples, rows="relative", sensors=given)
        return found.failures

    assert not failures(1.0)
    assert failures(1.03)
