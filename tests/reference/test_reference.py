"""The quickest cases of the reference table agree with it, and its truth conserves momentum."""

import json

import cases
import numpy as np
import pytest
import table

ROWS = json.loads(table.TABLE.read_text(encoding="utf-8"))["rows"]
QUICK = ("exact", "free_flyer_csv")
OTHERS = ("one_joint", "simulated_run", "20_Hz", "10_Hz")


@pytest.mark.parametrize(
    "case", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]
)
def test_a_quick_case_agrees_with_the_table(case):
    for rows in table.run([case]):
        assert rows
        assert not [text for fails, text in table.compare(ROWS, rows) if fails]


@pytest.mark.parametrize("change", [cases.tumbling, cases.lower_arm])
def test_the_truth_of_the_table_conserves_momentum_in_drake(change):
    """The momentum is Drake's sum over all bodies; the velocities are those of the positions."""
    world = change(cases.world_of("exciting_motion"))
    times = np.arange(0, 1.5, 1e-2)
    m, plant = world.run(times), world.plant
    context = plant.CreateDefaultContext()
    for k in (1, 75, 148):
        base = [*m["R"][k].as_quat(scalar_first=True), *m["p"][k]], [*m["w"][k], *m["v"][k]]
        state = [*base[0], *np.zeros(len(m["q"][k])), *base[1], *np.zeros(len(m["q"][k]))]
        plant.SetPositionsAndVelocities(context, state)
        for name, q, qdot in zip(world.craft.joint_names, m["q"][k], m["qdot"][k]):
            joint = plant.GetJointByName(name)
            joint.set_angle(context, q)
            joint.set_angular_rate(context, qdot)
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
        np.testing.assert_allclose(momentum, world.momentum, atol=1e-10)
        difference = (m["p"][k + 1] - m["p"][k - 1]) / 2e-2
        np.testing.assert_allclose(difference, m["v"][k], atol=1e-4)
