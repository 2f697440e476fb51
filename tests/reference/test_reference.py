"""The quickest cases of the reference table agree with it, and the comparison sees what moves."""

import json
from copy import deepcopy

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


def worse_error(row: dict) -> None:
    row["error"][0] += 0.5 * row["sigma"][0]


def smaller_sigma(row: dict) -> None:
    row["sigma"] = [0.8 * sigma for sigma in row["sigma"]]


def inconsistent(row: dict) -> None:
    row["nees"]["mean"] = 1.1 * row["nees"]["band99"][1]


def less_precise(row: dict) -> None:
    row["error_over_bound"]["rms"] *= 1.2


def failed_check(row: dict) -> None:
    row["checks_passed"] -= 1


def wrong(row: dict) -> None:
    row["confidently_wrong"] += 1


CHANGES = (worse_error, smaller_sigma, inconsistent, less_precise, failed_check, wrong)


@pytest.mark.parametrize("change", CHANGES)
def test_what_becomes_worse_fails(change):
    row = ROWS["10_Hz"] | {"error_over_bound": {"worst": 1.0, "rms": 1.0}}
    worse = deepcopy(row)
    change(worse)
    assert table.compare({"row": row}, {"row": row}) == []
    assert any(fails for fails, _ in table.compare({"row": row}, {"row": worse}))
