"""The shipped models: physically possible, as documented, and moved within their limits."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from cpid_drake import (
    InertialParameters,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.rows import RELATIVE_ROWS
from cpid_drake.resources import models_directory

URDFS = sorted(models_directory().glob("*/*.urdf"))
SCENARIOS = sorted((models_directory() / "scenarios").glob("*.yaml"))


def strictly_loaded(path) -> MultibodyPlant:
    """Strict parsing turns every warning of Drake into an error."""
    plant = MultibodyPlant(time_step=0.0)
    parser = Parser(plant)
    parser.SetStrictParsing()
    parser.AddModels(str(path))
    plant.Finalize()
    return plant


def bodies(plant) -> list:
    return [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.stem)
def test_every_body_is_physically_possible(path):
    for body in bodies(strictly_loaded(path)):
        inertia = body.default_spatial_inertia()
        if body.default_mass() == 0:
            assert not inertia.CopyToFullMatrix6().any(), body.name()
        else:
            assert inertia.IsPhysicallyValid(), body.name()
            assert not InertialParameters.from_spatial_inertia(inertia).infeasibilities()


_ARMS = ("capture", "operating")


def test_the_papers_target_is_the_scenarios_target(paper_scenario):
    """models/paper_target and models/scenarios/paper.yaml say the same of Table 1."""
    plant = strictly_loaded(models_directory() / "paper_target" / "paper_target.urdf")
    (body,) = bodies(plant)
    drawn = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
    truth = paper_scenario.target_truth()
    np.testing.assert_allclose(drawn.to_vector(), truth.to_vector(), rtol=1e-12, atol=1e-12)
    table_1 = [100.0, 0.4330127, 0.0, 0.0, 20.0, 30.0, 10.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(truth.to_vector(), table_1)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_builds_and_starts(path):
    simulation = make_simulation(load_scenario(path))
    assert simulation.make_simulator().get_context().get_time() == 0.0


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_joints_stay_within_their_limits(path):
    simulation = make_simulation(load_scenario(path))
    times = np.linspace(0.0, simulation.scenario.simulation.duration, 500)
    q, qdot, _ = np.moveaxis(simulation.joint_motion.evaluate(times), -2, 0)
    plant = simulation.spacecraft.plant
    columns = simulation.spacecraft.joint_state_columns[0]
    assert (q >= plant.GetPositionLowerLimits()[columns]).all()
    assert (q <= plant.GetPositionUpperLimits()[columns]).all()
    assert (np.abs(qdot) <= simulation.spacecraft.limits.rates).all()
    assert np.abs(qdot).max() > 0.0


# -- room to move --------------------------------------------------------------------------------

_BUS = (np.zeros(3), np.array([0.6, 0.7, 0.6]))  # boxes: centre and half size in the bus frame
_WINGS = [(np.array([-0.15, y, 0.0]), np.array([0.5, 1.3, 0.015])) for y in (2.4, -2.4)]
# Spheres that hold the target's body, its panel's stub, whip and dish: (centre, radius).
_TARGET_SPHERES = [([0.433, 0.0, z], 0.44) for z in (-0.4, 0.0, 0.4)] + [
    ([0.433, -0.07, 0.9], 0.37),
    ([0.63, 0.0, -0.76], 0.2),
    ([0.86, 0.0, 0.2], 0.18),
]


def distance_to_box(points, box) -> float:
    center, half = box
    return np.linalg.norm(np.maximum(np.abs(points - center) - half, 0.0), axis=-1).min()


def distance(points, others) -> float:
    return np.linalg.norm(points[:, None] - others, axis=-1).min()


def link_points(spacecraft, context, arm) -> list:
    """Points along the arm's links in the bus frame: shoulder, upper arm, forearm, hand."""
    names = [f"{arm}_arm_link{k}" for k in (1, 2, 3, 5)] + [f"{arm}_point"]
    base = spacecraft.base.body_frame()
    ends = [
        spacecraft.plant.GetFrameByName(name).CalcPose(context, base).translation()
        for name in names
    ]
    return [np.linspace(start, end, 21) for start, end in pairwise(ends)]


def of_the_servicer(path) -> bool:
    return "dual_arm_servicer" in load_scenario(path).spacecraft.model


@pytest.mark.parametrize(
    "path", [path for path in SCENARIOS if of_the_servicer(path)], ids=lambda path: path.stem
)
def test_arms_and_target_stay_clear_of_the_bus_and_of_each_other(path):
    """By 0.3 m, centrelines for links; upper arms by the 0.2 m that the shoulder is off the bus."""
    scenario = load_scenario(path)
    spacecraft = scenario.spacecraft.make()
    motion = scenario.make_joint_motion(spacecraft)
    context = spacecraft.plant.CreateDefaultContext()
    positions = spacecraft.plant.GetPositions(context)
    least = {"shoulder": np.inf, "elsewhere": np.inf}
    for q in motion.evaluate(np.linspace(0.0, motion.duration, 41))[:, 0]:
        positions[spacecraft.joint_state_columns[0]] = q
        spacecraft.plant.SetPositions(context, positions)
        capture, operating = (link_points(spacecraft, context, arm) for arm in _ARMS)
        gaps = [distance(np.vstack(capture), np.vstack(operating))]
        for shoulder, upper_arm, forearm, hand in (capture, operating):
            least["shoulder"] = min(least["shoulder"], distance_to_box(upper_arm, _BUS))
            outer = np.vstack([forearm, hand])
            gaps += [distance_to_box(outer, box) for box in (_BUS, *_WINGS)]
            gaps += [distance_to_box(upper_arm, box) for box in _WINGS]
            gaps += [distance(shoulder, outer), distance(upper_arm, hand)]
        X_BC = spacecraft.capture_frame.CalcPose(context, spacecraft.base.body_frame())
        for center, radius in _TARGET_SPHERES:
            center = X_BC.multiply(np.array(center))[None]
            gaps += [distance_to_box(center, box) - radius for box in (_BUS, *_WINGS)]
            gaps += [distance(center, np.vstack([*capture[:3], *operating])) - radius]
        least["elsewhere"] = min(least["elsewhere"], *gaps)
    assert least["shoulder"] > 0.2 - 1e-9
    assert least["elsewhere"] > 0.3


# -- the exciting motion -------------------------------------------------------------------------


@pytest.fixture
def exciting_scenario():
    return load_scenario(shipped_scenario("exciting_motion"))


def uncertainty(scenario) -> float:
    """Largest standard deviation, relative to its size, of m, c and I: equal noise in the rows."""
    spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
    motion, times = scenario.make_joint_motion(spacecraft), np.linspace(0.0, 10.0, 101)
    base = propagate_base(spacecraft.tree, motion, truth.to_standard_vector(), times)
    telemetry = base.to_telemetry(spacecraft.joint_names, times, motion)
    A = RELATIVE_ROWS.rows(momentum_samples(spacecraft.tree, telemetry))[0].reshape(-1, 10)
    parameterization = relative_parameterization(spacecraft.mass)
    jacobian = parameterization.jacobian(parameterization.from_parameters(truth.to_vector()))
    sigma = np.linalg.norm(jacobian @ np.linalg.pinv(A), axis=1)
    return max(sigma / np.repeat([truth.mass, 0.5, np.trace(truth.I_TTcm_C)], [1, 3, 6]))


def test_the_exciting_motion_says_far_more_than_the_papers(exciting_scenario, paper_scenario):
    """Some 90 times, as its file says."""
    gain = uncertainty(paper_scenario) / uncertainty(exciting_scenario)
    assert 85 < gain < 100


def test_the_exciting_motion_leaves_a_margin_and_uses_the_capture_arm_most(exciting_scenario):
    """A tenth of the velocity limits is left, and every joint moves."""
    spacecraft = exciting_scenario.spacecraft.make()
    motion = exciting_scenario.make_joint_motion(spacecraft)
    rates = np.abs(motion.evaluate(motion.instants())[:, 1]).max(axis=0)
    share = rates / spacecraft.limits.rates
    assert share.max() < 0.9
    assert share[:6].min() > share[6:].max() > share.min() > 0.4
