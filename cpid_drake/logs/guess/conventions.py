"""Chooses units and conventions of a log's columns by comparing its quantities with each other."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cpid_drake.logs.centre_of_mass import BaseTravel, base_travel
from cpid_drake.logs.consistency import attitude_mismatch, rate_mismatch
from cpid_drake.logs.guess.draft import MapDraft, least, stated_unit
from cpid_drake.logs.guess.names import unit_of
from cpid_drake.logs.log import Samples
from cpid_drake.logs.motion_checks import explained, in_degrees

_DIRECTIONS: tuple[Any, ...] = ("R_WB", "R_BW")

_CLEAR = 1.5
"""Ratio of errors above which one convention is right."""

_AGREE = 0.5
"""Mismatch of positions and rates above which they say nothing about each other."""


def choose_joint_units(draft: MapDraft) -> None:
    """Choose the units of joint positions by names, limits and momentum, then of rates."""
    given = draft.map.joint_positions
    limits = draft.spacecraft.limits
    low, high = limits.lowest, limits.highest
    turning = [body.joint for body in draft.spacecraft.tree.bodies if not body.prismatic]
    sliding = [n for k, n in enumerate(draft.spacecraft.joint_names) if k not in turning]
    values = {joint: draft.raw.values[column] for joint, column in given.columns.items()}
    revolute = [joint for joint in values if joint not in sliding]
    stated = stated_unit(given.columns[joint] for joint in revolute)
    # A wheel's angle grows without limit, and has no effect on the momentum.
    tree, names = draft.spacecraft.tree, draft.spacecraft.joint_names
    arms = [joint for joint in revolute if not tree.is_rotor(names.index(joint))]
    size = max((np.nanmax(np.abs(values[j])) for j in arms), default=0.0)
    fits_rad = _within(draft, values, arms, low, high, 1.0)
    if stated in ("deg", "rad", "mrad"):
        given.unit, why = stated, "the names say so"
    elif not fits_rad and _within(draft, values, arms, low, high, np.pi / 180):
        given.unit, why = "deg", "in rad they would exceed the joints' limits"
    elif (by_momentum := _unit_by_momentum(draft)) is not None:
        given.unit, why = by_momentum, "conservation of momentum says so"
    elif size > 4 * np.pi:
        given.unit, why = "deg", "in rad they would be more than two turns"
    else:
        given.unit, why = "rad", "assumed; they are within the joints' limits"
        if arms:
            draft.open.append("the joint positions may be in rad or deg (joint_positions.unit)")
    draft.say("joint_positions", f"in {given.unit}, the largest is {size:.4g}: {why}")
    if draft.map.joint_rates.columns:
        draft.map.joint_rates.unit = _rate_unit(draft, revolute)
    for joint in sliding:
        if joint in values:
            k = draft.spacecraft.joint_names.index(joint)
            far = np.nanmax(np.abs(values[joint])) > 2 * max(abs(low[k]), abs(high[k]))
            length = stated_unit([given.columns[joint]]) or cast(Any, "mm" if far else "m")
            given.units[joint] = length
            if joint in draft.map.joint_rates.columns:
                draft.map.joint_rates.units[joint] = cast(Any, f"{length}/s")


def _rate_unit(draft: MapDraft, joints: Sequence[str]) -> Any:
    """Return the unit of joint rates that agrees best with the positions."""
    stated = stated_unit(draft.map.joint_rates.columns[joint] for joint in joints)
    if stated in ("deg", "rad", "mrad", "rpm"):
        draft.say("joint_rates", f"in {stated}: the names say so")
        return stated if stated == "rpm" else f"{stated}/s"

    def mismatch(unit: Any) -> float:
        read = draft.measurements(joint_rates=replace(draft.map.joint_rates, unit=unit))
        found = []
        for joint in joints:
            k = read.joint_names.index(joint)
            pair = [Samples(s.time, s.value[:, [k]]) for s in (read.encoders, read.joint_rates)]
            found.append(rate_mismatch(pair[0], pair[1]))
        return float(np.median([f for f in found if f is not None] or [0.0]))

    unit, error = least(mismatch, ("rad/s", "deg/s", "rpm"))
    draft.say("joint_rates", f"in {unit}: differ from the positions' changes by {error:.2%}")
    return unit


def _within(
    draft: MapDraft,
    values: dict[str, NDArray[np.float64]],
    joints: Sequence[str],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    scale: float,
) -> bool:
    """Return whether the positions in a unit of this scale are within the joints' limits."""
    for joint in joints:
        k, q = draft.spacecraft.joint_names.index(joint), values[joint] * scale
        if np.nanmin(q) < low[k] - 0.1 or np.nanmax(q) > high[k] + 0.1:
            return False
    return True


def _unit_by_momentum(draft: MapDraft) -> Any:
    """Return the unit with which momentum is conserved, in any convention of the attitude.

    None if there are no positions of the base, or if both units explain them equally well.
    """
    given = draft.map.attitude
    errors = {False: [np.inf], True: [np.inf]}
    for order, direction in product(_orders(draft), _DIRECTIONS):
        section = replace(given, order=order, direction=direction)
        travel = base_travel(draft.measurements(attitude=section)) if given.columns else None
        for degrees, found in errors.items():
            if travel is not None:
                found.append(_motion_error(draft, travel, degrees=degrees))
    in_rad, in_deg = min(errors[False]), min(errors[True])
    if max(in_rad, in_deg) < _CLEAR * min(in_rad, in_deg) or not np.isfinite(in_rad):
        return None
    return "deg" if in_deg < in_rad else "rad"


def _orders(draft: MapDraft) -> tuple[Any, ...]:
    """Return the orders of the attitude that its columns' names leave open."""
    if draft.map.attitude.order == "rotation_vector":
        return "rotation_vector", "euler_xyz"
    return ("wxyz", "xyzw") if draft.has_free_order else (draft.map.attitude.order,)


def _motion_error(draft: MapDraft, travel: BaseTravel, *, degrees: bool = False) -> float:
    """Return how badly momentum conservation explains the motion, relative to the motion."""
    tree = draft.spacecraft.tree
    return explained(tree, in_degrees(tree, travel) if degrees else travel).least


def choose_attitude_conventions(draft: MapDraft) -> None:
    """Choose order and direction of the attitude, unit and frame of the angular velocity."""
    given, rate = draft.map.attitude, draft.map.angular_velocity
    if not given.columns:
        return
    orders, directions = _orders(draft), _DIRECTIONS
    if rate.columns:
        stated = unit_of(rate.columns[0])
        units = (rate.unit,) if stated else ("rad/s", "deg/s")
        combinations: list[Any] = list(product(orders, directions, ("body", "world"), units))

        def by_gyro(choice: tuple[Any, ...]) -> float:
            read = draft.measurements(
                attitude=replace(given, order=choice[0], direction=choice[1]),
                angular_velocity=replace(rate, frame=choice[2], unit=choice[3]),
            )
            found = attitude_mismatch(read.attitude, read.gyro)
            return 1.0 if found is None else found

        best, error = least(by_gyro, combinations)
        if error < _AGREE:
            given.order, given.direction, rate.frame, rate.unit = best
            said = (
                f"of the {len(combinations)} combinations of conventions this agrees best: "
                f"attitude changes and angular velocity differ by {error:.2%}"
            )
            draft.say("attitude", f"{given.order}, {given.direction}: {said}")
            draft.say("angular_velocity", f"in {rate.unit}, axes of the {rate.frame}: {said}")
            return
        if error < 1.0:  # the gyro moves, and contradicts every convention: momentum cannot help
            draft.open.append(
                "the attitude does not turn at the angular velocity in any convention (they differ "
                f"by {error:.0%} at least): order and direction of the attitude, or the axes of "
                "one of the sensors, are not determined"
            )
            return
    if not draft.map.position.columns:
        draft.say("attitude", f"{given.order}, {given.direction}: assumed, nothing to compare")
        return
    choices = list(product(orders, directions))

    def by_momentum(choice: tuple[Any, ...]) -> float:
        read = draft.measurements(attitude=replace(given, order=choice[0], direction=choice[1]))
        travel = base_travel(read)
        return 1.0 if travel is None else _motion_error(draft, travel)

    (given.order, given.direction), error = least(by_momentum, choices)
    if error > _AGREE:
        draft.open.append(
            f"order and direction of the attitude are not determined: the best, {given.order} and "
            f"{given.direction}, explains only {max(1 - error, 0):.0%} of the base's motion "
            "(attitude.order, attitude.direction)"
        )
    draft.say(
        "attitude",
        f"{given.order}, {given.direction}: with this convention, conservation of momentum "
        f"explains all but {error:.2%} of the base's motion",
    )


def choose_position_unit_and_point(draft: MapDraft) -> None:
    """Choose the unit of the position and its point of the base by conservation of momentum."""
    given = draft.map.position
    if not (given.columns and draft.map.attitude.columns):
        return
    stated = unit_of(given.columns[0])
    travel = base_travel(draft.measurements())
    expected = None
    if travel is not None:
        expected = explained(draft.spacecraft.tree, travel).explanation
    if expected is None:
        draft.say("position", f"in {given.unit}: {'by name' if stated else 'assumed'}")
        return
    if stated is None:
        given.unit = cast(Any, expected.unit)
        draft.say(
            "position",
            f"in {given.unit}: the target then has {expected.fit.mass_share:.3g} of the total "
            "mass, by the motion of the centre of mass",
        )
    point = expected.fit.point_B
    if not expected.is_origin and np.linalg.norm(point) > 0.05 * expected.fit.reach:
        given.point_B = np.round(point, 4)
        said = "the centre of mass moves evenly if the position is that of this point"
        draft.say("position", f"point {given.point_B.tolist()} m in B: {said}")
    elif stated is None or expected.is_origin:
        draft.say("position", "of B's origin: the centre of mass then moves evenly")


def choose_velocity_conventions(draft: MapDraft) -> None:
    """Choose unit and frame of the velocity by the changes of the position."""
    given = draft.map.velocity
    if not given.columns:
        return
    stated = unit_of(given.columns[0])
    if not draft.map.position.columns:
        draft.say("velocity", f"in {given.unit}, axes of the world: assumed")
        return
    units = (given.unit,) if stated else ("m/s", "mm/s", "cm/s")
    choices = list(product(("world", "body"), units))

    def mismatch(choice: tuple[Any, ...]) -> float:
        point = draft.map.position.point_B if draft.map.angular_velocity.columns else np.zeros(3)
        section = replace(given, frame=choice[0], unit=choice[1], point_B=point)
        read = draft.measurements(velocity=section)
        found = rate_mismatch(read.position, read.velocity)
        return 1.0 if found is None else found

    (given.frame, given.unit), error = least(mismatch, choices)
    if draft.map.angular_velocity.columns:
        given.point_B = draft.map.position.point_B
    draft.say(
        "velocity",
        f"in {given.unit}, axes of the {given.frame}: differs from the position's changes by "
        f"{error:.2%}",
    )
