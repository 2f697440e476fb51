"""No impossible number is shown with an interval, whatever the rank of the estimate."""

import numpy as np
import pytest
from planar_cases import KNOWN, TARGET, planar_craft
from pydrake import solvers
from scipy.stats import chi2

from cpid_drake import identify
from cpid_drake.dynamics.parameterizations import (
    STANDARD,
    parameters_to_standard,
    relative_parameterization,
)
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.identification.consistency import checked
from cpid_drake.identification.result import Identification
from cpid_drake.sensors.suite import SensorSuite

PLACES = np.array([0, 1, 2, 9])


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    return planar_craft(tmp_path_factory.mktemp("planar")).on_table().tree


def in_plane(m, hx, hy, J33, sigma, tree) -> Identification:
    """Return an identification of the four standard unknowns of motion in the plane."""
    x, R = np.zeros(10), np.zeros((4, 10))
    x[PLACES], R[:, PLACES] = [m, hx, hy, J33], np.diag(1 / np.asarray(sigma, dtype=float))
    told = Gaussian.of_rows({"x": 10}, np.column_stack([R, R @ x]))
    ten = solution_of(told, x, 1e6 * np.ones(10), row_count=100)
    known = {"sample_count": 100, "estimator": "least_squares", "sensors": SensorSuite()}
    return checked(Identification.of_solution(STANDARD, ten, **known), tree)


def test_an_interval_shows_only_what_a_rigid_body_can_have(tree):
    found = in_plane(2.0, 0.0, 0.0, 0.01, [0.01, 0.001, 0.001, 0.02], tree)
    assert found.intervals[6, 0] < 0  # the free interval, which is kept
    np.testing.assert_allclose(found.consistent_intervals[6], [0, found.intervals[6, 1]])
    for place in (0, 1, 2):
        np.testing.assert_allclose(found.consistent_intervals[place], found.intervals[place])
    text = str(found)
    assert f"[{found.intervals[6, 0]:.4f}" not in text
    assert found.passed


def test_an_impossible_estimate_has_no_interval_and_is_doubted(tree):
    found = in_plane(2.0, 0.0, 0.0, -0.05, [0.01, 0.001, 0.001, 0.001], tree)
    assert not found.is_consistent
    assert found.failures
    text = str(found)
    assert "[" not in text.replace("[kg", "")
    assert "No interval is given" in text


@pytest.mark.parametrize("seed", [2, 3])
def test_the_nearest_rigid_body_is_as_far_as_noise_that_residuals_show_puts_it(
    servicer, skewed_target, zero_momentum_motion, seed
):
    """Of so many rows that they show it exactly, the limit is that of ten unknowns, squared χ²."""
    found = identify(servicer, zero_momentum_motion(skewed_target, 2500, seed), rows="standard")
    limit = found.check("distance of the nearest rigid body").limit
    assert limit**2 == pytest.approx(chi2.isf(1e-4, 10), rel=0.02)


def test_a_centre_of_mass_too_far_for_the_moment_is_doubted(tree):
    """J about C is at least m |c|²: every number alone is possible, all together are not."""
    found = in_plane(2.0, 0.4, 0.0, 0.05, [0.01, 0.001, 0.001, 0.001], tree)
    assert not found.is_consistent  # m |c|² = 0.08
    assert any("no rigid body" in failure for failure in found.failures)


def test_a_solver_that_fails_passes_no_check(tree, monkeypatch):
    """Clarabel with a single iteration ends without a solution."""

    class Hurried(solvers.ClarabelSolver):
        def Solve(self, program):
            options = solvers.SolverOptions()
            options.SetOption(self.solver_id(), "max_iter", 1)
            return super().Solve(program, None, options)

    monkeypatch.setattr(solvers, "ClarabelSolver", Hurried)
    found = in_plane(2.0, 0.0, 0.0, 0.1, [0.01, 0.001, 0.001, 0.02], tree)
    assert not found.passed
    assert any("could not be computed" in failure for failure in found.failures)


def test_random_estimates_of_a_real_body_keep_it_inside(tree):
    """The shown interval holds the truth whenever the free interval does."""
    truth = TARGET.to_vector()
    x = parameters_to_standard(truth)[PLACES]
    sigma = np.array([0.1, 0.01, 0.01, 0.08])
    rng = np.random.default_rng(2)
    kept = 0
    for _ in range(40):
        found = in_plane(*(x + sigma * rng.standard_normal(4)), sigma, tree)
        low, high = found.intervals[KNOWN].T
        is_in = (low <= truth[KNOWN]) & (truth[KNOWN] <= high)
        low, high = found.consistent_intervals[KNOWN].T
        assert (is_in <= ((low <= truth[KNOWN]) & (truth[KNOWN] <= high))).all()
        assert (low[[0, 3]] >= 0).all()
        others = np.delete(np.arange(10), KNOWN)
        low, high = found.consistent_intervals[others].T
        assert ((low <= truth[others]) & (truth[others] <= high)).all()
        kept += bool((found.consistent_intervals != found.intervals)[KNOWN].any())
    assert kept > 10  # the trial is about narrowed intervals


def test_a_flat_body_stays_inside_of_what_is_shown(tree):
    """All ten are known, and noise puts estimates beyond the triangle inequality."""
    form, rng = relative_parameterization(tree.mass), np.random.default_rng(4)
    cut = 0
    for _ in range(30):
        side, other = rng.uniform(0.02, 0.06, 2)
        truth = np.array([2.0, 0.1, -0.05, 0.0, side, other, side + other, 0.0, 0.0, 0.0])
        R = form.jacobian(form.from_parameters(truth))
        R /= np.array([0.02, *3 * [0.003], *6 * [0.03]])[:, None]
        values = form.from_parameters(truth) + np.linalg.solve(R, rng.standard_normal(10))
        told = Gaussian.of_rows({"psi": 10}, np.column_stack([R, R @ values]))
        solution = solution_of(told, values, 1e6 * np.ones(10), row_count=100)
        known = {"sample_count": 100, "estimator": "trajectory_fit", "sensors": SensorSuite()}
        found = checked(Identification.of_solution(form, solution, **known), tree)
        assert found.passed
        low, high = found.intervals.T
        is_in = (low <= truth) & (truth <= high)
        low, high = found.consistent_intervals.T
        assert (is_in <= ((low <= truth) & (truth <= high))).all()
        cut += bool((found.consistent_intervals != found.intervals).any())
    assert cut > 10
