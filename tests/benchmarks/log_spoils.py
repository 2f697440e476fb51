"""Ways to spoil a log: functions of its samples or of its columns."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.files.table import table_of
from cpid_drake.sensing.measurements import Measurements, Samples

Columns = dict[str, NDArray[np.float64]]
Spoil = Callable[[Measurements], Measurements]
ColumnSpoil = Callable[[Columns], Columns]


def columns_of(measurements: Measurements) -> Columns:
    """Return the columns of a log."""
    names, values = table_of(measurements)
    return dict(zip(names, values.T, strict=True))


def in_turn(*spoils: Spoil) -> Spoil:
    """Return a spoil that applies several, the first one first."""

    def apply(m: Measurements) -> Measurements:
        for spoil in spoils:
            m = spoil(m)
        return m

    return apply


def changed(name: str, change: Callable[[Samples], Samples]) -> Spoil:
    """Return a spoil of the samples of one sensor."""
    return lambda m: m.updated({name: change(m[name])})


def values_of(name: str, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Spoil:
    """Return a spoil of one sensor's values (N, width)."""
    return changed(name, lambda s: Samples(s.time, change(s.value)))


def without(*names: str) -> Spoil:
    """Return a spoil that removes sensors."""
    return lambda m: Measurements(
        m.joint_names, {name: s for name, s in m.items() if name not in names and len(s)}
    )


# -- units ----------------------------------------------------------------------------------------


def scaled(name: str, factor: float) -> Spoil:
    """Return a spoil that multiplies a sensor's values."""
    return values_of(name, lambda value: factor * value)


def scaled_columns(factor: float, prefixes: tuple[str, ...]) -> ColumnSpoil:
    """Return a spoil that multiplies the columns whose names begin with one of these prefixes."""
    return lambda columns: {
        name: values * factor if name.startswith(prefixes) else values
        for name, values in columns.items()
    }


def renamed(old: str, new: str) -> ColumnSpoil:
    """Return a spoil that gives the columns `old`… names that begin with `new` instead."""
    return lambda columns: {
        new + name.removeprefix(old) if name.startswith(old) else name: values
        for name, values in columns.items()
    }


def added_column(name: str, value: float) -> ColumnSpoil:
    """Return a spoil that adds a column with a constant value."""
    return lambda columns: {**columns, name: np.full(columns["time"].size, value)}


def rounded(decimals: int, *prefixes: str) -> ColumnSpoil:
    """Return a spoil that rounds the columns with these prefixes, or all but the time."""
    return lambda columns: {
        name: np.round(values, decimals)
        if name.startswith(prefixes or tuple(set(columns) - {"time"}))
        else values
        for name, values in columns.items()
    }


# -- frames ---------------------------------------------------------------------------------------


def attitude_at(m: Measurements, times: NDArray[np.float64]) -> Rotation:
    """Return R_WB at these times: interpolated between the samples of the attitude."""
    first = m.attitude
    relative = Rotation.from_quat(first.value, scalar_first=True)
    origin = relative[0]
    vectors = (origin.inv() * relative).as_rotvec()
    return origin * Rotation.from_rotvec(
        np.stack([np.interp(times, first.time, each) for each in vectors.T], axis=1)
    )


def turned_by_attitude(name: str, inverse: bool) -> Spoil:
    """Return a spoil that gives a sensor's vectors in W instead of B, or inversely in B."""

    def apply(m: Measurements) -> Measurements:
        R_WB = attitude_at(m, m[name].time)
        return values_of(name, lambda value: R_WB.apply(value, inverse=inverse))(m)

    return apply


def moved_point(p_BQ: ArrayLike) -> Spoil:
    """Return a spoil whose position (and velocity) is that of a point Q of B (3,) [m]."""

    def apply(m: Measurements) -> Measurements:
        m = values_of("position", lambda p: p + attitude_at(m, m.position.time).apply(p_BQ))(m)
        if len(m.velocity):
            w_W = attitude_at(m, m.gyro.time).apply(m.gyro.value)
            w_W = np.stack([np.interp(m.velocity.time, m.gyro.time, w) for w in w_W.T], axis=1)
            arm = attitude_at(m, m.velocity.time).apply(p_BQ)
            m = values_of("velocity", lambda v: v + np.cross(w_W, arm))(m)
        return m

    return apply


def turned_world(rotvec: ArrayLike, *names: str) -> Spoil:
    """Return a spoil that expresses some of attitude, position and velocity in another world."""
    turn = Rotation.from_rotvec(rotvec)

    def apply(m: Measurements) -> Measurements:
        for name in names:
            if name == "attitude":
                m = attitude_of(lambda R_WB: turn * R_WB)(m)
            else:
                m = values_of(name, turn.apply)(m)
        return m

    return apply


def turned_body(rotvec: ArrayLike, *names: str) -> Spoil:
    """Return a spoil in which attitude or gyro belong to axes that are turned in B."""
    turn = Rotation.from_rotvec(rotvec)

    def apply(m: Measurements) -> Measurements:
        for name in names:
            if name == "attitude":
                m = attitude_of(lambda R_WB: R_WB * turn)(m)
            else:
                m = values_of(name, lambda value: turn.apply(value, inverse=True))(m)
        return m

    return apply


def conjugated() -> Spoil:
    """Return a spoil with the quaternion of R_BW."""
    return attitude_of(lambda R_WB: R_WB.inv())


def attitude_of(change: Callable[[Rotation], Rotation]) -> Spoil:
    """Return a spoil of the attitude R_WB."""

    def values(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = change(Rotation.from_quat(quaternions, scalar_first=True))
        return np.asarray(turned.as_quat(scalar_first=True))

    return values_of("attitude", values)


def reordered(name: str, order: list[int], signs: list[float]) -> Spoil:
    """Return a spoil that exchanges a sensor's entries and changes their signs."""
    return values_of(name, lambda value: value[:, order] * signs)


# -- joints ---------------------------------------------------------------------------------------


def joint_values(joint: str, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Spoil:
    """Return a spoil of one joint's positions and rates; `change` gets their values (N,)."""
    return in_turn(
        *(joint_column(name, joint, lambda t, value: change(value)) for name in JOINT_SENSORS)
    )


JOINT_SENSORS = ("encoders", "joint_rates")


def joint_column(
    name: str,
    joint: str,
    change: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
) -> Spoil:
    """Return a spoil of one joint in one sensor; `change` gets times and values (N,)."""

    def apply(m: Measurements) -> Measurements:
        samples, value = m[name], m[name].value.copy()
        if len(samples):
            k = m.joint_names.index(joint)
            value[:, k] = change(samples.time, value[:, k])
        return m.updated({name: Samples(samples.time, value)})

    return apply


def exchanged_joints(names: dict[str, str]) -> ColumnSpoil:
    """Return a spoil that exchanges the names of joints."""
    both = {**names, **{new: old for old, new in names.items()}}

    def apply(columns: Columns) -> Columns:
        result = {}
        for name, values in columns.items():
            prefix, _, joint = name.partition(":")
            result[f"{prefix}:{both[joint]}" if joint in both else name] = values
        return result

    return apply
