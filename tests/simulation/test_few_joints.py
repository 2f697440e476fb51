"""Spacecraft without arms: they are simulated and checked, and no motion is planned for them."""

import numpy as np
import pytest
from model_parts import joint, link, moments, urdf
from pydrake.geometry import StartMeshcat
from sensing_cases import FREE

from cpid_drake import InputError, SceneVisualizer, Spacecraft, load_scenario, make_simulation
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import load_planner
from cpid_drake.simulation.limits import check_limits

BUS = link("bus", 200.0, com="0 0 0", **moments(20.0, 22.0, 24.0))
WHEEL = (
    link("wheel", 4.0, com="0 0 0", com_rpy="0 0 0", **moments(0.04, 0.03, 0.03)),
    joint("spin", "bus", "wheel", "continuous", "1 0 0", "0.2 0.0 -0.3", **FREE),
)


@pytest.fixture(params=["no joints", "wheels only"])
def scenario(request, tmp_path):
    """Return the path of a scenario of a bus that holds a target."""
    parts = WHEEL if request.param == "wheels only" else ()
    (tmp_path / "craft.urdf").write_text(urdf(BUS, *parts, name="craft"))
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "spacecraft: {model: craft.urdf, base: bus, capture_frame: bus}\n"
        "target: {mass: 20.0, p_CTcm_C: [0.5, 0.1, 0.2], "
        "I_TTcm_C: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}\n"
        "simulation: {duration: 1.0}\n"
    )
    return path


def test_they_are_simulated_and_their_limits_are_checked(scenario):
    simulation = make_simulation(load_scenario(scenario))
    assert check_limits(simulation).exceeded == ()
    motion = simulation.motion(simulation.run())
    np.testing.assert_allclose(motion.w_WB, 0.0, atol=1e-9)  # nothing moves


def test_no_motion_is_planned_for_them(scenario):
    with pytest.raises(InputError, match=r"no motion can be planned .* w(hose|ithout)"):
        load_planner(scenario, None, PlanOptions()).run()


def test_a_scene_has_a_size_where_all_frames_are_at_one_place(tmp_path):
    (tmp_path / "craft.urdf").write_text(urdf(BUS, name="craft"))
    craft = Spacecraft(tmp_path / "craft.urdf", base="bus", capture_frame="bus")
    SceneVisualizer(craft, meshcat=StartMeshcat())
