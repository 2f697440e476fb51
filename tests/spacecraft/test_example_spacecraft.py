"""The example spacecraft: wheels that turn, and a payload that is nearly as heavy as its holder."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import (
    InertialParameters,
    identify,
    load_scenario,
    make_simulation,
    shipped_scenario,
)

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


@pytest.mark.parametrize("rows", ["standard", "eq18", "relative"])
@pytest.mark.slow
def test_the_target_is_identified_from_exact_samples(run, rows):
    simulation, telemetry, _ = run
    result = identify(simulation.spacecraft, telemetry, rows=rows)
    assert result.rank == 10
    assert relative_error(result.parameters, simulation.truth) < 1e-8


def test_the_target_is_identified_online(run):
    simulation, _, estimate = run
    assert relative_error(estimate, simulation.truth) < 1e-8


# -- wheels --------------------------------------------------------------------------------------


@pytest.mark.parametrize("run", ["single_arm_wheels"], indirect=True)
def test_wheels_that_are_not_counted_spoil_the_estimate(run):
    """Their momentum is small beside the arm's, but far from nothing."""
    simulation, telemetry, _ = run
    qdot = telemetry.qdot.copy()
    qdot[:, :4] = 0.0
    result = identify(simulation.spacecraft, replace(telemetry, qdot=qdot), rows="standard")
    assert relative_error(result.parameters, simulation.truth) > 1e-3
