"""Motion: what it refuses, how it is cut, and what rounding does to it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, Motion


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


def entry(value):
    return lambda values: np.where(np.arange(values.size).reshape(values.shape) == 4, value, values)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("w_WB", entry(np.nan), "'w_WB' is not finite in sample 1$"),
        ("q", entry(np.inf), "'q' is not finite in sample 2$"),
        ("time", lambda time: time[[0, 1, 1, 2, 3]], "does not increase at sample 2"),
        ("time", lambda time: time[[0, 2, 1, 3, 4]], "does not increase at sample 2"),
        ("p_WB", lambda values: values[:-1], "'p_WB' must have shape"),
        ("qdot", lambda values: values[:, :-1], "'qdot' must have shape"),
        ("quaternion_WB", lambda q: 0 * q, "not of unit norm in sample 0"),
        ("quaternion_WB", lambda q: 1.01 * q, "not of unit norm in sample 0"),
    ],
)
def test_what_is_no_motion_is_refused_with_its_sample(telemetry, name, change, message):
    with pytest.raises(InputError, match=message):
        replace(telemetry, **{name: change(getattr(telemetry, name))})


def test_euler_angles_are_yaw_pitch_roll():
    """R = Rz(yaw) Ry(pitch) Rx(roll), composed here by hand."""
    angles = (0.7, -0.3, 1.1)
    Rz, Ry, Rx = (Rotation.from_rotvec(a * n) for a, n in zip(angles, np.eye(3)[::-1]))
    quaternion_WB = (Rz * Ry * Rx).as_quat(scalar_first=True)[None]
    found = replace(make(1), quaternion_WB=quaternion_WB).euler_321
    np.testing.assert_allclose(found, [angles], atol=1e-14)


@pytest.mark.parametrize("decimals", [0, 6, 12])
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
