"""`cpid plan`: a motion in a file that simulates, what to expect of it, one-line errors."""

import re
import sys
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.commands.main import main
from cpid_drake.commands.plan import motion
from cpid_drake.planning import pareto
from cpid_drake.planning.pareto import FrontPoint
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.search import Candidate
from cpid_drake.scenario.joint_motions import dump_motion, load_motion

SMALL = ("--candidates", 64, "--starts", 1, "--frequency", 0.3, "--targets", 1, "--jobs", 1)
ARM = tuple(word for k in range(1, 4) for word in ("--joint", f"capture_arm_joint{k}"))


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A plan of the paper's scenario: its file, and the command's output."""
    folder, text = tmp_path_factory.mktemp("plan"), StringIO()
    file, page = folder / "motion.yaml", folder / "motion.html"
    arguments = ("plan", "motion", "paper", "--out", file, "--report", page, *SMALL, *ARM)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(text):
        patch.setattr(sys, "argv", ["cpid", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0
    return file, text.getvalue()


def worst(text: str) -> list[float]:
    [line] = [each for each in text.splitlines() if "worst σ" in each]
    return [float(number) for number in re.findall(r"[-+.\de]+", line.split("scale")[1])]


@pytest.mark.slow
def test_a_plan_is_written_compared_exported_and_simulated(run_cpid, planned, tmp_path):
    file, text = planned
    own, plan = worst(text)
    assert own > plan
    assert "σ(Iyz), kg·m²" in text
    assert "active limits: " in text

    page = file.with_suffix(".html").read_text()
    assert f"{plan:.3g} % of its scale" in page
    for heading in ("Conclusion", "Predicted σ", "Joints", "Base motion", "Replay", "Provenance"):
        assert f">{heading}</h2>" in page

    code, ranking, _ = run_cpid("plan", "rank", "paper", file)
    assert code == 0
    assert "motion.yaml scenario's motion" in " ".join(ranking.split())
    assert worst(ranking) == [plan, own]

    table = tmp_path / "motion.csv"
    arguments = ("--scenario", "paper", "--out", table, "--rate", 10)
    assert run_cpid("plan", "export", file, *arguments)[0] == 0
    values = np.loadtxt(table, delimiter=",", skiprows=1)
    assert values.shape == (101, 37)

    scenario = tmp_path / "scenario.yaml"
    lines = shipped_scenario("paper").read_text().split("joint_motion:")
    rest = lines[1][lines[1].index("\ncontroller:") :]
    scenario.write_text(f"{lines[0]}joint_motion: !MotionFile {{file: {file}}}\n{rest}")
    simulated = make_simulation(load_scenario(scenario)).joint_motion
    np.testing.assert_allclose(simulated.evaluate(3.0).ravel(), values[30, 1:], atol=1e-9)


def test_an_interrupt_keeps_the_best_motion_so_far(tmp_path, monkeypatch):

    def interrupted(planner, progress):
        family = planner.problem.family
        shape = family.count, len(family.moving)
        planner.best = Candidate(np.full(shape, 0.01), 0.5)
        raise KeyboardInterrupt

    monkeypatch.setattr(Planner, "run", interrupted)
    file = tmp_path / "motion.yaml"
    with pytest.raises(KeyboardInterrupt):
        motion("paper", file, targets=1, jobs=1)
    assert "is 0.5 in units" in file.read_text()
    assert file.read_text().startswith("# Interrupted: ")
    assert load_motion(file).duration == 10.0


def test_a_better_motion_of_the_front_becomes_the_plan(tmp_path, monkeypatch):
    """The front goes on from the plan, and may find a motion that is better in both respects."""
    plan, better = (Candidate(np.full((5, 12), size), score) for size, score in PLANS)
    monkeypatch.setattr(Planner, "run", lambda planner, progress: plan)
    points = [FrontPoint(better, 0.2), FrontPoint(replace(plan, score=0.7), 0.1)]
    monkeypatch.setattr(pareto, "front", lambda *arguments, **options: points)
    file = tmp_path / "motion.yaml"
    motion("paper", file, front=tmp_path / "front", targets=1, jobs=1, frequency=0.3, quiet=True)
    assert "is 0.4 in units" in file.read_text()
    assert not file.read_text().startswith("# Interrupted: ")
    assert file.read_text() == (tmp_path / "front/motion_00.yaml").read_text()


PLANS = ((0.01, 0.5), (0.02, 0.4))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("motion", "paper"), "--out"),
        (("paper",), "paper"),
        (("motion", "nowhere.yaml", "--out", "x.yaml"), "nowhere.yaml: no such file"),
        (
            ("motion", "paper", "--out", "x.yaml", "--duration", "12", "--opportunistic", "1"),
            "give either --duration or --opportunistic",
        ),
        (("motion", "paper", "--out", "x.yaml", "--sensors", "none"), "none: no such file"),
        (("motion", "paper", "--out", "x.yaml", "--frequency", "100"), "give a highest frequency"),
        (
            ("motion", "paper", "--out", "x.yaml", "--wheel-momentum", "1"),
            "the spacecraft has no wheels",
        ),
        (("rank", "paper", "nowhere.yaml"), "nowhere.yaml: no such file"),
        (("export", "nowhere.yaml", "--scenario", "paper", "--out", "x.csv"), "no such file"),
    ],
)
def test_errors_are_one_line(arguments, message, run_cpid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, error = run_cpid("plan", *arguments)
    assert (code, out) == (2, "")
    assert error.count("\n") == 1
    assert message in error
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_motion_of_another_spacecraft_is_refused(run_cpid, planned, tmp_path):
    file, _ = planned
    text = dump_motion(load_motion(file)).replace("capture_arm_joint1", "elbow")
    other = tmp_path / "other.yaml"
    other.write_text(text)
    code, _, error = run_cpid("plan", "rank", "paper", other)
    assert code == 2
    assert "no joint 'elbow'" in error


def test_the_help_has_the_units(run_cpid):
    code, text, _ = run_cpid("plan", "motion", "--help")
    assert code == 0
    text = " ".join(re.sub("[│\n]", " ", text).split())
    assert "--acceleration" in text
    for unit in ("[s]", "[Hz]", "[m]", "[deg]", "[deg/s]", "[rad/s² or m/s²]", "[N·m·s]"):
        assert unit in text
