"""Motion: what it refuses, how it is cut, and what rounding does to it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, Motion

ARRAYS = ("quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")


def make(n: int = 5, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(
        ("shoulder", "elbow"),
        np.arange(n) * 0.5,
        quaternion_WB=Rotation.random(n, rng).as_quat(scalar_first=True).reshape(n, 4),
        p_WB=rng.normal(size=(n, 3)),
        w_WB=rng.normal(size=(n, 3)),
        v_WB=rng.normal(size=(n, 3)),
        q=rng.normal(size=(n, 2)),
        qdot=rng.normal(size=(n, 2)),
    )


@pytest.fixture
def telemetry() -> Motion:
    return make()


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_entry_that_is_not_finite_is_refused_with_its_sample(telemetry, name, bad):
    values = getattr(telemetry, name).copy()
    values[3, 1] = bad
    with pytest.raises(InputError, match=f"'{name}' is not finite in sample 3$"):
        replace(telemetry, **{name: values})


@pytest.mark.parametrize("time", [[0, 1, 1, 2, 3], [0, 1, 0.5, 2, 3]])
def test_time_must_increase(telemetry, time):
    with pytest.raises(InputError, match="does not increase at sample 2"):
        replace(telemetry, time=time)


@pytest.mark.parametrize("name", ARRAYS)
def test_a_shape_that_does_not_fit_is_refused(telemetry, name):
    with pytest.raises(InputError, match=f"'{name}' must have shape"):
        replace(telemetry, **{name: getattr(telemetry, name)[:-1]})
    with pytest.raises(InputError, match=f"'{name}' must have shape"):
        replace(telemetry, **{name: getattr(telemetry, name)[:, :-1]})


@pytest.mark.parametrize("scale", [0.0, 0.99, 1.01, 1e100])
def test_a_quaternion_far_from_unit_norm_is_refused_with_its_sample(telemetry, scale):
    quaternion_WB = telemetry.quaternion_WB.copy()
    quaternion_WB[4] = scale * quaternion_WB[4]
    with pytest.raises(InputError, match=r"not of unit norm in sample 4$"):
        replace(telemetry, quaternion_WB=quaternion_WB)


def test_euler_angles_are_yaw_pitch_roll():
    """R = Rz(yaw) Ry(pitch) Rx(roll), composed here by hand."""
    angles = (0.7, -0.3, 1.1)
    Rz, Ry, Rx = (Rotation.from_rotvec(a * n) for a, n in zip(angles, np.eye(3)[::-1]))
    quaternion_WB = (Rz * Ry * Rx).as_quat(scalar_first=True)[None]
    found = replace(make(1), quaternion_WB=quaternion_WB).euler_321
    np.testing.assert_allclose(found, [angles], atol=1e-14)


@pytest.mark.parametrize("decimals", [0, 1, 3, 6, 9, 12])
def test_rounding_moves_numbers_by_half_a_unit_of_the_last_place(decimals):
    telemetry = make(200, seed=1)
    rounded = telemetry.rounded(decimals)
    np.testing.assert_array_equal(rounded.time, telemetry.time)
    for name in ("p_WB", "w_WB", "v_WB", "q", "qdot"):
        error = np.abs(getattr(rounded, name) - getattr(telemetry, name)).max()
        assert 0.3 * 10.0**-decimals < error <= 0.5 * 10.0**-decimals + 1e-15
    turn = Rotation.from_matrix(rounded.R_WB) * Rotation.from_matrix(telemetry.R_WB).inv()
    # Half a unit in each of three angles turns by at most 3/2 units.
    assert turn.magnitude().max() <= 1.5 * 10.0**-decimals + 1e-12
