"""The other orders, directions, frames and axes in which attitude and gyro could be read."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import conjugate, rotate
from cpid_drake.logs.axes import signed_axes, turn_between
from cpid_drake.logs.column_map import QUATERNION_ORDERS, UNITS, ColumnMap, scale_of
from cpid_drake.logs.instants import Instants

TURNS = ("rad/s", "deg/s", "rpm")
"""Units of angular velocities that are compared."""

OTHER_AXES = "attitude and angular velocity belong to other axes of the base than the model's"
"""What is wrong if both have the same turn."""

Reading = tuple[str, Instants, Mapping[str, Any]]
"""What is wrong, what the log then says, and the entries of the map."""


def attitudes(given: Instants, column_map: ColumnMap) -> Iterator[Reading]:
    """Yield orders and directions of the attitude with units and frames of the gyro."""
    at, gyro, w_B = column_map.attitude, column_map.angular_velocity, given.values.get("gyro")
    is_plain = at.order in QUATERNION_ORDERS and np.array_equal(at.R_BS, np.eye(3))
    frame_now = "world" if gyro.frame == "world" else "body"
    orders: tuple[str, ...] = QUATERNION_ORDERS if is_plain else (at.order,)
    directions: tuple[str, ...] = ("R_WB", "R_BW")
    frames: tuple[str, ...] = ("body", "world") if w_B is not None else (frame_now,)
    if "attitude" not in given.values:
        orders, directions, frames = (at.order,), (at.direction,), (frame_now,)
    logged = w_B
    if w_B is not None and frame_now == "world":
        logged = rotate(given.R_WB, w_B)
    for order, direction, frame, unit in product(
        orders, directions, frames, TURNS if w_B is not None else (gyro.unit,)
    ):
        texts, entries = [], {}
        if order != at.order:
            entries["attitude.order"] = order
            texts.append(f"the quaternion is in the order {', '.join(order)}")
        if direction != at.direction:
            entries["attitude.direction"] = direction
            texts.append(f"the attitude is that of {direction}, not of {at.direction}")
        if frame != frame_now:
            entries["angular_velocity.frame"] = frame
            axes = "W's axes, not in B's" if frame == "world" else "B's axes, not in W's"
            texts.append(f"the angular velocity is expressed in {axes}")
        if unit != gyro.unit:
            entries["angular_velocity.unit"] = unit
            texts.append(f"the angular velocity is in {word_of(unit)}")
        if not entries:
            continue
        reordered = partial(_reordered, now=at.order, order=order, turns=direction != at.direction)
        log = given.changed(attitude=reordered)
        if logged is not None:
            R_BW = np.swapaxes(log.R_WB, 1, 2)
            w = rotate(R_BW, logged) if frame == "world" else logged
            w = scale_of(unit) / scale_of(gyro.unit) * w
            log = replace(log, values={**log.values, "gyro": w})
        yield "; and ".join(texts), log, entries


def other_axes(given: Instants, column_map: ColumnMap) -> Iterator[Reading]:
    """Yield other axes of attitude, gyro and position, and mirrored logs."""
    if "attitude" not in given.values:
        return
    at, gyro = column_map.attitude.R_BS, column_map.angular_velocity.R_BS
    has_place = bool({"position", "velocity"} & given.values.keys())
    for axes, M in signed_axes():
        names = f"{', '.join(axes)} are x, y, z"
        in_axes = partial(rotate, M)
        turned = given.changed(gyro=in_axes)
        entries = gyro_axes(given, column_map, (M @ gyro).tolist())
        if entries:
            yield f"the gyro has other axes than the base: its {names}", turned, entries
        if np.linalg.det(M) > 0:
            log = in_axes_of_base(given, M)
            entries = {"attitude.R_BS": (M @ at).tolist(), **entries}
            yield f"{OTHER_AXES}: their {names}", log, entries
        if has_place:
            text = "the position is expressed in other axes than the attitude"
            yield f"{text}: its {names}", given.changed(position=in_axes, velocity=in_axes), {}
    for k, name in enumerate("xyz" if has_place else ""):
        mirror = np.where(np.arange(3) == k, -1.0, 1.0)
        log = given.scaled(mirror, "position", "velocity").scaled(-mirror, "gyro")
        log = log.scaled(np.append(1.0, -mirror), "attitude")
        yield f"the axes are left-handed: the log is mirrored along {name}", log, {}


def gyro_axes(given: Instants, column_map: ColumnMap, R_BS: ArrayLike) -> dict[str, Any]:
    """Return the entry with which a map gives the axes of a gyro, if they are a body's."""
    is_of_body = "gyro" in given.values and column_map.angular_velocity.frame != "world"
    return {"angular_velocity.R_BS": R_BS} if is_of_body else {}


def in_axes_of_base(given: Instants, M: Array) -> Instants:
    """Return a log whose attitude and gyro are those of axes in which M v is the vector v."""
    turn = Rotation.from_matrix(M).inv().as_quat(scalar_first=True)
    return given.changed(gyro=partial(rotate, M), attitude=partial(_product, b=turn))


def turned_axes(given: Instants, column_map: ColumnMap) -> Iterator[Reading]:
    """Yield axes of the gyro, or of the attitude, that are turned by any angle.

    The size of the angular velocity, which no turn changes, says the gyro's unit.
    """
    at, gyro = column_map.attitude.R_BS, column_map.angular_velocity
    w, turning = given.values.get("gyro"), given.turning
    if w is None or turning is None or (M := turn_between(turning, w)) is None:
        return
    ratio = np.log(np.linalg.norm(turning) / np.linalg.norm(w) * scale_of(gyro.unit))
    unit = min(TURNS, key=lambda each: abs(ratio - np.log(scale_of(each))))
    size, turn = scale_of(unit) / scale_of(gyro.unit), Rotation.from_matrix(M)
    degrees, axis = np.degrees(turn.magnitude()), turn.as_rotvec() / turn.magnitude()
    units, also = dict[str, Any](), ""
    if unit != gyro.unit:
        units, also = {"angular_velocity.unit": unit}, f"; and its rates are in {word_of(unit)}"
    of_gyro = given.changed(gyro=partial(rotate, size * M))
    turned = partial(_product, b=turn.as_quat(scalar_first=True))
    of_base = given.scaled(size, "gyro").changed(attitude=turned)
    for text, way, log, entries in (
        ("axes of the gyro are", axis, of_gyro, gyro_axes(given, column_map, M @ gyro.R_BS)),
        ("attitude is that of axes", -axis, of_base, {"attitude.R_BS": M.T @ at}),
    ):
        words = f"the {text} turned by {degrees:.1f}° about {plain(rounded(way, 2))} from those"
        if not entries:
            continue
        digits = {key: rounded(value) for key, value in entries.items()}
        yield f"{words} of the base{also}", log, {**digits, **units}


def _reordered(quaternion: Array, now: str, order: str, turns: bool) -> Array:
    """Return quaternions or their rates as read in another order and direction."""
    if order != now:  # the entries of the file: scalar first or last
        quaternion = quaternion[:, [3, 0, 1, 2] if order == "xyzw" else [1, 2, 3, 0]]
    return conjugate(quaternion) if turns else quaternion


def _product(a: Array, b: Array) -> Array:
    """Return quaternions a (N, 4), or their rates, times a constant one (4,)."""
    vector = a[:, :1] * b[1:] + b[0] * a[:, 1:] + np.cross(a[:, 1:], b[1:])
    return np.hstack([a[:, :1] * b[0] - a[:, 1:] @ b[1:, None], vector])


def word_of(unit: str) -> str:
    """Return a unit in words."""
    return UNITS[unit.removesuffix("/s")][1].split()[0] + (" per second" if "/" in unit else "")


def rounded(values: Array, digits: int = 4) -> list[Any]:
    """Return rounded numbers as lists, without negative zeros."""
    return [*(np.round(values, digits) + 0.0).tolist()]


def plain(value: object) -> str:
    """Return a value as in a map."""
    if isinstance(value, list):
        return "[" + ", ".join(map(plain, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
