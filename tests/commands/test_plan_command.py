"""`cpid plan`: a motion in a file that simulates, what to expect of it, one-line errors."""

import re

import numpy as np
import pytest

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.planning.planner import Planner
from cpid_drake.simulation.joint_motions import dump_motion, load_motion

ARM = tuple(word for k in range(1, 4) for word in ("--joint", f"capture_arm_joint{k}"))
SMALL = ("--candidates", 32, "--frequency", 0.3, "--targets", 1, *ARM)


def worst(text: str, heading="worst σ") -> list[float]:
    [line] = [each for each in text.splitlines() if heading in each]
    return [float(number) for number in re.findall(r"[-+.\de]+", line.split("scale")[1])]


@pytest.mark.slow
def test_a_plan_is_written_drawn_compared_exported_and_simulated(run_cpid, tmp_path):
    file, page = tmp_path / "motion.yaml", tmp_path / "plan.html"
    code, text, _ = run_cpid("plan", "motion", "paper", "--out", file, "--report", page, *SMALL)
    assert code == 0
    own, plan = worst(text)
    assert own > plan
    assert "σ(Iyz), kg·m²" in text
    assert "active limits: " in text
    assert re.search(r"Planned motion: worst σ \S+ % of scale</h1>", page.read_text())

    code, ranking, _ = run_cpid("plan", "rank", "paper", file, "--trials", 2, *ARM)
    assert code == 0
    assert "rank correlation of predicted and realised errors: " in ranking
    names = ["motion.yaml", "best of", "multi-axis", "random binary", "scenario's motion"]
    [heads] = [line for line in ranking.splitlines() if "multi-axis" in line]
    places = [heads.index(name) for name in names]
    assert max(places) == places[-1]

    table = tmp_path / "motion.csv"
    assert run_cpid("plan", "export", "paper", file, "--out", table, "--rate", 10)[0] == 0
    values = np.loadtxt(table, delimiter=",", skiprows=1)
    assert values.shape == (101, 37)

    scenario = tmp_path / "scenario.yaml"
    lines = shipped_scenario("paper").read_text().split("joint_motion:")
    rest = lines[1][lines[1].index("\ncontroller:") :]
    scenario.write_text(f"{lines[0]}joint_motion: !MotionFile {{file: {file}}}\n{rest}")
    simulated = make_simulation(load_scenario(scenario)).joint_motion
    np.testing.assert_allclose(simulated.evaluate(3.0).ravel(), values[30, 1:], atol=1e-9)

    other = tmp_path / "other.yaml"
    other.write_text(dump_motion(load_motion(file)).replace("capture_arm_joint1", "elbow"))
    code, _, error = run_cpid("plan", "rank", "paper", other)
    assert code == 2
    assert "no joint 'elbow'" in error


@pytest.mark.slow
def test_a_plan_that_is_worse_than_the_scenario_s_motion_says_so(run_cpid, tmp_path):
    few = ("--candidates", 16, "--iterations", 2, "--frequency", 0.15, "--targets", 1)
    file = tmp_path / "motion.yaml"
    code, text, error = run_cpid("plan", "motion", "free_flyer_payload", "--out", file, *few)
    own, plan = worst(text)
    assert code == 0
    assert own < plan
    assert "determines the target better than the plan" in text + error


def test_an_interrupt_keeps_the_best_motion_so_far(run_cpid, tmp_path, monkeypatch):

    def interrupted(planner, progress):
        assert planner.consider(np.full(planner.family.shape, 0.01))
        raise KeyboardInterrupt

    monkeypatch.setattr(Planner, "run", interrupted)
    file = tmp_path / "motion.yaml"
    code, _, error = run_cpid("plan", "motion", "paper", "--out", file, *SMALL)
    assert (code, error) == (130, "cpid: interrupted\n")
    assert load_motion(file).duration == 10.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("motion", "paper"), "--out"),
        (("motion", "paper", "--out", "x.yaml", "--report", "x.yaml"), "cannot be the same file"),
        (("motion", "paper", "--out", "x.yaml", "--frequency", "100"), "give a highest frequency"),
    ],
)
def test_errors_are_one_line(arguments, message, run_cpid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, error = run_cpid("plan", *arguments)
    assert (code, out) == (2, "")
    assert error.count("\n") == 1
    assert message in error
    assert not list(tmp_path.iterdir())
