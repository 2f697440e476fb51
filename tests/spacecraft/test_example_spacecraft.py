"""The example spacecraft: wheels that turn, and a payload that is nearly as heavy as its holder."""

import re
from dataclasses import replace

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
