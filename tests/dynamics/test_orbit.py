"""A circular orbit: against integrated equations, conserved quantities and sums over masses."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cpid_drake import InputError
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.parameterizations import point_mass_inertia

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])
ORBIT = Orbit(rate=0.02, nadir_W=3 * TURN.apply([-1, 0, 0]), normal_W=2 * TURN.apply([0, 0, 1]))


def test_the_nadir_turns_once_in_a_period_about_the_normal():
    times = np.linspace(0, 2 * np.pi / ORBIT.n, 5)
    nadir, normal = ORBIT.nadir(times), ORBIT.normal_W / 2
    np.testing.assert_allclose(nadir @ normal, 0, atol=1e-14)
    np.testing.assert_allclose(nadir[[0, 4]], np.stack(2 * [ORBIT.nadir_W / 3]), atol=1e-14)
    np.testing.assert_allclose(nadir[2], -nadir[0], atol=1e-14)
    # The centre is below, so the orbit turns about its normal in the same sense as the nadir.
    np.testing.assert_allclose(np.cross(nadir[0], nadir[1]), normal, atol=1e-14)


def test_a_geostationary_orbit_takes_a_sidereal_day():
    assert 2 * np.pi / Orbit(altitude_km=35_786.0).n == pytest.approx(86_164.1, rel=1e-4)


def test_the_transition_solves_the_equation_of_motion():
    times = np.array([7.0, 12.0, 40.0, 300.0])
    p_v = np.array([10.0, -5.0, 3.0, 0.2, 0.1, -0.3])

    def rate(t, y):
        return np.concatenate([y[3:], ORBIT.tide(np.array([t]))[0] @ y[:3]])

    solved = solve_ivp(rate, (7.0, 300.0), p_v, t_eval=times, rtol=1e-12, atol=1e-12)
    predicted = ORBIT.transition(7.0, times) @ p_v
    np.testing.assert_allclose(predicted, solved.y.T, rtol=0, atol=1e-8)


def test_a_central_field_gives_the_same_tide():
    """Of two bodies in an inverse-square field, a metre apart on an orbit of 7000 km."""
    mu, radius = 3.986004418e14, 7e6
    orbit = Orbit(rate=np.sqrt(mu / radius**3), nadir_W=ORBIT.nadir_W, normal_W=ORBIT.normal_W)
    centre = radius * orbit.nadir(np.zeros(1))[0]

    def gravity(p):
        return mu * (centre - p) / np.linalg.norm(centre - p) ** 3

    for axis in np.eye(3):
        difference = (gravity(50 * axis) - gravity(-50 * axis)) / 100
        expected = orbit.tide(np.zeros(1))[0] @ axis
        np.testing.assert_allclose(difference, expected, rtol=0, atol=1e-12)


def test_the_torque_is_that_of_the_tide_on_the_masses():
    rng = np.random.default_rng(3)
    masses, p, times = rng.uniform(1, 5, 6), rng.normal(size=(6, 3)), np.array([3.0])
    com = masses @ p / masses.sum()
    forces = masses[:, None] * (p @ ORBIT.tide(times)[0].T)
    torque = np.cross(p - com, forces).sum(axis=0)
    J = sum(point_mass_inertia(m, x - com) for m, x in zip(masses, p, strict=True))
    np.testing.assert_allclose(ORBIT.torque(J[None], times)[0], torque, rtol=0, atol=1e-15)
    acceleration = forces.sum(axis=0) / masses.sum()
    np.testing.assert_allclose(ORBIT.tide(times)[0] @ com, acceleration, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, "give one of altitude_km and rate"),
        ({"altitude_km": 500.0, "rate": 0.001}, "give one of altitude_km and rate"),
        ({"rate": 0.001, "nadir_W": np.zeros(3)}, "directions, not zero"),
        ({"rate": 0.001, "nadir_W": np.array([0, 1.0, -1.0])}, "perpendicular; .* 45.0°"),
    ],
)
def test_an_orbit_that_is_not_determined(given, problem):
    with pytest.raises(InputError, match=problem):
        Orbit(**given)
