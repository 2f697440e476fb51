"""Joint motions of scenarios: splines, sines, and motions in files of their own."""

import numpy as np
import pytest
import yaml

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.simulation.joint_motions import (
    MotionFile,
    MultiSineMotion,
    SplineMotion,
    dump_motion,
    load_motion,
)
from cpid_drake.simulation.scenario_files import dump_scenario, files_of

SPLINE = SplineMotion(
    5.0, {"capture_arm_joint2": np.array([0.1, 0.1, 0.1, 0.5, -0.3, -0.2, -0.2, -0.2])}
)
SINES = MultiSineMotion(
    8.0,
    2.0,
    np.array([0.2]),
    {"capture_arm_joint1": 0.3},
    {"capture_arm_joint1": np.array([0.1])},
    {"capture_arm_joint1": np.array([0.5])},
    final={"capture_arm_joint1": 0.5},
)


@pytest.fixture(scope="module")
def paper():
    return load_scenario(shipped_scenario("paper"))


@pytest.fixture
def spacecraft(paper_scenario):
    return paper_scenario.spacecraft.make()


@pytest.mark.parametrize("motion", [SPLINE, SINES], ids=lambda m: type(m).__name__)
def test_a_file_of_its_own_is_the_same_motion(motion, spacecraft, tmp_path):
    path = tmp_path / "motion.yaml"
    path.write_text(dump_motion(motion))
    read = load_motion(path)
    assert type(read) is type(motion)
    t, default = np.linspace(0, 8, 17), {"operating_arm_joint2": 0.7}
    expected = motion.make(spacecraft, default).evaluate(t)
    np.testing.assert_array_equal(read.make(spacecraft, default).evaluate(t), expected)
    other = spacecraft.joint_names.index("operating_arm_joint2")
    np.testing.assert_allclose(expected[:, 0, other], 0.7, rtol=1e-14)


def test_sines_end_at_the_final_positions(spacecraft):
    end = SINES.make(spacecraft, {}).evaluate(8.0)[0]
    first = spacecraft.joint_names.index("capture_arm_joint1")
    assert end[first] == pytest.approx(0.5)
    assert not np.delete(end, first).any()


def test_a_scenario_can_name_a_file_of_its_folder(tmp_path):
    (tmp_path / "motion.yaml").write_text(dump_motion(SPLINE))
    tree = yaml.safe_load(shipped_scenario("paper").read_text())
    del tree["joint_motion"]
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(tree) + "joint_motion: !MotionFile {file: motion.yaml}\n")
    scenario = load_scenario(path)
    assert isinstance(scenario.joint_motion, MotionFile)
    assert tmp_path / "motion.yaml" in files_of(scenario)
    simulation = make_simulation(scenario)
    expected = SPLINE.make(simulation.spacecraft, {}).evaluate(2.0)
    np.testing.assert_array_equal(simulation.joint_motion.evaluate(2.0), expected)
    again = tmp_path / "again.yaml"
    again.write_text(dump_scenario(scenario))
    assert load_scenario(again).joint_motion == scenario.joint_motion
