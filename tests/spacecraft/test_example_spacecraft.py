"""The example spacecraft: wheels that turn, and a payload that is nearly as heavy as its holder."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake import (
    InertialParameters,
    identify,
    load_scenario,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.resources import models_directory

EXAMPLES = {"single_arm_wheels": 4.0, "free_flyer_payload": 4.0}  # enough to simulate [s]


@pytest.fixture(scope="module", params=EXAMPLES)
def run(request):
    """Return a simulation and its telemetry: the example's first half."""
    scenario = load_scenario(shipped_scenario(request.param))
    scenario.simulation.duration = EXAMPLES[request.param]
    simulation = make_simulation(scenario)
    context = simulation.run()
    identifier = simulation.identifier
    estimate = identifier.GetOutputPort("parameters").Eval(identifier.GetMyContextFromRoot(context))
    return simulation, simulation.telemetry(context), estimate


def relative_error(parameters, truth: InertialParameters) -> float:
    scale = np.repeat([truth.mass, 0.5, np.trace(truth.I_TTcm_C)], [1, 3, 6])
    return np.abs((parameters - truth.to_vector()) / scale).max()


def test_total_momentum_stays_zero(run):
    simulation, telemetry, _ = run
    context = simulation.plant.CreateDefaultContext()
    for state in simulation.spacecraft.to_states(telemetry):
        simulation.plant.SetPositionsAndVelocities(context, state)
        L_WWo = simulation.plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
        assert np.linalg.norm(L_WWo.translational()) < 1e-8
        assert np.linalg.norm(L_WWo.rotational()) < 1e-8


@pytest.mark.parametrize("rows", ["standard", "eq18", "relative"])
def test_the_target_is_identified_from_exact_samples(run, rows):
    simulation, telemetry, _ = run
    result = identify(simulation.spacecraft, telemetry, rows=rows)
    assert result.solution.rank == 10
    assert relative_error(result.parameters, simulation.truth) < 1e-8


def test_the_target_is_identified_online(run):
    simulation, _, estimate = run
    assert relative_error(estimate, simulation.truth) < 1e-8


# -- wheels --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wheels_scenario():
    return load_scenario(shipped_scenario("single_arm_wheels"))


def test_wheels_point_along_the_diagonals(wheels_scenario):
    """As models/README.md says: three of any four span space."""
    spacecraft = wheels_scenario.spacecraft.make()
    context = spacecraft.plant.CreateDefaultContext()
    for k in range(1, 5):
        frame = spacecraft.plant.GetFrameByName(f"wheel{k}")
        X_BWheel = frame.CalcPose(context, spacecraft.base.body_frame())
        place, spin_axis = X_BWheel.translation(), X_BWheel.rotation().matrix()[:, 2]
        np.testing.assert_allclose(np.abs(place), [0.55, 0.31, 0.27], atol=1e-12)
        signs = [1.0, np.sign(place[1]), np.sign(place[2])]
        np.testing.assert_allclose(spin_axis * np.sqrt(3), signs, atol=1e-9)


@pytest.mark.parametrize("run", ["single_arm_wheels"], indirect=True)
def test_wheels_that_are_not_counted_spoil_the_estimate(run):
    """Their momentum is small beside the arm's, but far from nothing."""
    simulation, telemetry, _ = run
    qdot = telemetry.qdot.copy()
    qdot[:, :4] = 0.0
    result = identify(simulation.spacecraft, replace(telemetry, qdot=qdot), rows="standard")
    assert relative_error(result.parameters, simulation.truth) > 1e-3


# -- room to move --------------------------------------------------------------------------------

# The base's boxes (centre, half size), spheres that hold the target (centre in C, radius), links
# between which the arm's centreline runs, and the gap that the scenario's file speaks of [m].
ROOM = {
    "single_arm_wheels": (
        [((0, 0, 0), (0.45, 0.5, 0.45))] + [((-0.1, y, 0), (0.4, 1.0, 0.02)) for y in (1.8, -1.8)],
        [
            ((0.52 + x, y, z), 0.44)
            for x in (-0.2, 0.2)
            for y in (-0.15, 0.15)
            for z in (-0.15, 0.15)
        ],
        ["arm_link1", "arm_link3", "arm_link5", "arm_link6", "capture_point"],
        0.2,
    ),
    "free_flyer_payload": (
        [((0, 0, 0), (0.16, 0.16, 0.16))],
        [((0.255 + x, y, 0), 0.235) for x in (-0.06, 0.06) for y in (-0.08, 0.08)],
        ["arm_link2", "arm_link3", "arm_link4", "capture_point"],
        0.08,
    ),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_arm_and_target_stay_clear_of_the_base_and_of_each_other(name):
    """Beyond the first piece of the arm, which is mounted on the base; centrelines for links."""
    boxes, spheres, links, gap = ROOM[name]
    scenario = load_scenario(shipped_scenario(name))
    spacecraft = scenario.spacecraft.make()
    motion = scenario.make_joint_motion(spacecraft)
    base = spacecraft.base.body_frame()
    context = spacecraft.plant.CreateDefaultContext()
    positions = spacecraft.plant.GetPositions(context)
    gaps = []
    for q in motion.evaluate(np.linspace(0.0, motion.duration, 61))[:, 0]:
        positions[spacecraft.joint_state_columns[0]] = q
        spacecraft.plant.SetPositions(context, positions)
        frames = [spacecraft.plant.GetFrameByName(link) for link in links]
        ends = [frame.CalcPose(context, base).translation() for frame in frames]
        pieces = [np.linspace(*piece, 9) for piece in pairwise(ends)]
        X_BC = spacecraft.capture_frame.CalcPose(context, base)
        held = [(X_BC.multiply(np.array(center))[None], radius) for center, radius in spheres]
        for points, radius in [(np.vstack(pieces[1:]), 0.0), *held]:
            for center, half in boxes:
                outside = np.maximum(np.abs(points - np.array(center)) - half, 0.0)
                gaps.append(np.linalg.norm(outside, axis=1).min() - radius)
        for center, radius in held:
            gaps.append(np.linalg.norm(np.vstack(pieces[:-1]) - center, axis=1).min() - radius)
    assert min(gaps) > gap


# -- what they hold ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "model"),
    [("single_arm_wheels", "small_satellite"), ("free_flyer_payload", "cargo_bag")],
)
def test_target_model_scenario_and_readme_say_the_same(scenario, model):
    truth = load_scenario(shipped_scenario(scenario)).target_truth()
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(str(models_directory() / model / f"{model}.urdf"))
    drawn = InertialParameters.from_spatial_inertia(
        plant.GetBodyByName(model).default_spatial_inertia()
    )
    np.testing.assert_allclose(drawn.to_vector(), truth.to_vector(), rtol=1e-12, atol=1e-12)
    readme = (models_directory() / "README.md").read_text()
    (row,) = re.findall(rf"^\| `{model}` \| (.*)$", readme, re.M)
    numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", row)]
    np.testing.assert_array_equal(numbers, truth.to_vector())
