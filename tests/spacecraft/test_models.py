"""The shipped models: physically possible, as documented, and moved within their limits."""

import re

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from cpid_drake import (
    InertialParameters,
    load_scenario,
    shipped_scenario,
)
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.rows import RELATIVE_ROWS
from cpid_drake.files.resources import models_directory

URDFS = sorted(models_directory().glob("*/*.urdf"))


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


def test_the_joints_that_the_page_of_the_models_names_are_there():
    page = (models_directory() / "README.md").read_text()
    named = set(re.findall(r"`([^`]*(?:_joint|_spin)[^`]*)`", page))
    there = {
        plant.get_joint(k).name()
        for plant in map(strictly_loaded, URDFS)
        for k in plant.GetJointIndices()
    }
    assert {"capture_arm_joint1", "wheel4_spin"} <= named <= there


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.stem)
def test_every_body_is_physically_possible(path):
    for body in bodies(strictly_loaded(path)):
        inertia = body.default_spatial_inertia()
        if body.default_mass() == 0:
            assert not inertia.CopyToFullMatrix6().any(), body.name()
        else:
            assert inertia.IsPhysicallyValid(), body.name()
            assert not InertialParameters.from_spatial_inertia(inertia).inconsistencies()


def test_the_papers_target_is_the_scenarios_target(paper_scenario):
    """models/paper_target and models/scenarios/paper.yaml say the same of Table 1."""
    plant = strictly_loaded(models_directory() / "paper_target" / "paper_target.urdf")
    (body,) = bodies(plant)
    drawn = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
    truth = paper_scenario.target_truth()
    np.testing.assert_allclose(drawn.to_vector(), truth.to_vector(), rtol=1e-12, atol=1e-12)
    table_1 = [100.0, 0.4330127, 0.0, 0.0, 20.0, 30.0, 10.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(truth.to_vector(), table_1)


# -- the exciting motion -------------------------------------------------------------------------


@pytest.fixture
def exciting_scenario():
    return load_scenario(shipped_scenario("exciting_motion"))


def uncertainty(scenario) -> float:
    """Largest standard deviation, relative to its size, of m, c and I: equal noise in the rows."""
    spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
    motion, times = scenario.make_joint_motion(spacecraft), np.linspace(0.0, 10.0, 101)
    base = propagate(spacecraft.tree, motion, truth.to_standard_vector(), times)
    telemetry = base.to_motion(spacecraft.joint_names, times, motion)
    A = RELATIVE_ROWS.rows(momentum_samples(spacecraft.tree, telemetry))[0].reshape(-1, 10)
    parameterization = relative_parameterization(spacecraft.mass)
    jacobian = parameterization.jacobian(parameterization.from_parameters(truth.to_vector()))
    sigma = np.linalg.norm(jacobian @ np.linalg.pinv(A), axis=1)
    return max(sigma / np.repeat([truth.mass, 0.5, np.trace(truth.I_TTcm_C)], [1, 3, 6]))


def test_the_exciting_motion_says_far_more_than_the_papers(exciting_scenario, paper_scenario):
    """Some 90 times, as its file says."""
    gain = uncertainty(paper_scenario) / uncertainty(exciting_scenario)
    assert 85 < gain < 100
