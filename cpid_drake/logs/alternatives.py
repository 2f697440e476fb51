"""The other conventions in which a log could be read, as maps of columns and as what it then says.

Each differs from the given map in one convention: a unit, an order or a direction of the attitude,
axes, a sign, the clock, or which joint is which. Attitude and gyro are one convention, since only
together they agree.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.attitude_alternatives import (
    TURNS,
    Reading,
    attitudes,
    other_axes,
    plain,
    turned_axes,
    word_of,
)
from cpid_drake.logs.column_map import ColumnMap, scale_of
from cpid_drake.logs.instants import Instants
from cpid_drake.logs.score import explain_by_momentum

UNEXPLAINED_DISTANCE = 0.05
"""Distance of a point from B's origin, in reaches of the arm, that model errors do not explain."""

LEAST_TRAVEL = 0.1
"""Travel [rad] that a unit must leave to one of all turning joints: of joints that hardly move, a
free target explains any motion."""

_LENGTHS, _SPEEDS = ("m", "mm", "cm", "in"), ("m/s", "mm/s", "cm/s", "in/s")
_ANGLES = ("rad", "deg")
_ALL_JOINTS, _ALL_WHEELS = "all turning joints", "all wheels"
_JOINTS = ("encoders", "joint_rates")


@dataclass(frozen=True, eq=False)
class Alternative:
    """A log read in one other convention.

    Attributes:
        text: what is then wrong in the log as read, in words.
        log: what the log then says.
        tree: the spacecraft model.
        entries: by key of the map of columns, with dots, the values that read the log so; empty if
            no map can.
        count: how many conventions are then others.

    """

    text: str
    log: Instants
    tree: KinematicTree | None
    entries: Mapping[str, Any]
    count: int = 1

    def then(self, other: "Alternative") -> "Alternative":
        """Return both together, given an alternative to this one."""
        text = f"{self.text}; and {other.text}" if self.text else other.text
        entries = {**self.entries, **other.entries}
        return Alternative(text, other.log, other.tree, entries, self.count + other.count)

    @property
    def is_point(self) -> bool:
        """Whether the position is that of another point, and nothing else is different."""
        return [*self.entries] == ["position.point_B"]

    @property
    def sentence(self) -> str:
        """What is wrong, and the remedy."""
        if not self.entries:
            return self.text
        remedy = ", ".join(f"{key}: {plain(value)}" for key, value in self.entries.items())
        return f"{self.text} ({remedy} in a map of columns)"


def alternatives(
    given: Instants,
    names: tuple[str, ...],
    tree: KinematicTree | None,
    column_map: ColumnMap,
    keys: Collection[str] | None = None,
) -> Iterator[Alternative]:
    """Yield the log in every other convention.

    Args:
        given: what the log says as read.
        names: the joints.
        tree: the spacecraft model; None if it is not known.
        column_map: the map it is read with.
        keys: those of the map that may have other values; None for all, and for what no map says.

    """
    families = {
        "time": _clocks(given, column_map),
        "joint_positions joint_rates reversed_joints": _joints(given, names, tree, column_map),
        "attitude angular_velocity": attitudes(given, column_map),
        "attitude.R_BS angular_velocity.R_BS": chain(
            other_axes(given, column_map),
            turned_axes(given, column_map) if keys is None else (),  # is asked about
        ),
        "position velocity": _places(given, tree, column_map),
    }
    for parts, readings in families.items():
        wanted = tuple(parts.split())
        if keys is not None and not any(key.startswith(wanted) for key in keys):
            continue  # they take long
        for text, log, entries in readings:
            if keys is None or (entries and entries.keys() <= {*keys}):
                yield Alternative(text, log, tree, entries)
    if keys is not None:
        return
    for k, body in enumerate(() if tree is None else tree.bodies):
        if tree is not None and body.parent >= 0 and k != tree.capture_body:
            held = replace(tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
            text = f"the body '{body.name}' of the model, not the capture frame, holds the target"
            yield Alternative(text, given, held, {})


def _units(
    given: Instants, text: str, key: str, now: str, units: tuple[str, ...], *quantities: str
) -> Iterator[Reading]:
    """Yield quantities in other units than now."""
    for unit in units:
        if unit != now:
            log = given.scaled(scale_of(unit) / scale_of(now), *quantities)
            yield f"{text} in {word_of(unit)}", log, {key: unit}


def _clocks(given: Instants, column_map: ColumnMap) -> Iterator[Reading]:
    now = column_map.time.unit
    for unit in ("s", "ms", "us", "ns") if now != "frame" else ():
        if unit != now:
            size = scale_of(unit) / scale_of(now)
            rates = {name: rate / size for name, rate in given.rates.items()}
            text = f"positions and rates agree if the time is in {word_of(unit)}"
            yield text, replace(given, time=size * given.time, rates=rates), {"time.unit": unit}


def _joints(
    given: Instants, names: tuple[str, ...], tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Reading]:
    """Yield units and signs of all turning joints, of all wheels and of each joint; exchanges."""
    at, rate_at, count = column_map.joint_positions, column_map.joint_rates, len(names)
    has_rates = "joint_rates" in given.values
    rotors, sliding = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    if tree is not None:
        rotors[:] = [tree.is_rotor(k) for k in range(count)]
        sliding[[*tree.sliding]] = True

    def reversed_too(name: str) -> list[str]:
        return sorted({*column_map.reversed_joints} ^ {name})

    groups = [(_ALL_JOINTS, ~sliding), (_ALL_WHEELS, rotors)]
    groups += [(name, np.arange(count) == k) for k, name in enumerate(names)]
    for label, chosen in groups:
        if not chosen.any():
            continue
        which, many = np.flatnonzero(chosen), f" of {label}"
        q, qd = (f"{word}:{label}" if label in names else word + many for word in ("q", "qd"))
        first, slides = names[which[0]], bool(sliding[which[0]])
        keys = ["unit"] if label == _ALL_JOINTS else [f"units.{names[k]}" for k in which]
        now = at.units.get(first, "m" if slides else at.unit)
        rate_now = rate_at.units.get(first, "m/s" if slides else rate_at.unit)
        for unit in _LENGTHS if slides else _ANGLES:
            if unit == now or label == _ALL_WHEELS:  # the angle of a wheel has no effect
                continue
            size = np.where(chosen, scale_of(unit) / scale_of(now), 1.0)
            travel = np.ptp(size * given.values["encoders"], axis=0)
            if label == _ALL_JOINTS and travel[chosen].max() < LEAST_TRAVEL:
                continue
            entries = {f"joint_positions.{key}": unit for key in keys}
            yield f"{q} is in {word_of(unit)}", given.scaled(size, "encoders"), entries
            if has_rates:
                entries = {**entries, **{f"joint_rates.{key}": f"{unit}/s" for key in keys}}
                yield f"{q} and {qd} are in {word_of(unit)}", given.scaled(size, *_JOINTS), entries
        for unit in (_SPEEDS if slides else TURNS) if has_rates else ():
            if unit != rate_now:
                size = np.where(chosen, scale_of(unit) / scale_of(rate_now), 1.0)
                entries = {f"joint_rates.{key}": unit for key in keys}
                yield f"{qd} is in {word_of(unit)}", given.scaled(size, "joint_rates"), entries
        signs = np.where(chosen, -1.0, 1.0)
        if has_rates:
            text = f"{qd} is the rate of {q} with the opposite sign"
            yield text, given.scaled(signs, "joint_rates"), {}
        if label in names and not rotors[which[0]]:
            text = f"{q} has the opposite sign of the model's joint"
            yield text, given.scaled(signs, *_JOINTS), {"reversed_joints": reversed_too(label)}
    for text, order in _orders(names, rotors):
        pick = partial(np.take, indices=order, axis=1)
        log = given.changed(encoders=pick, joint_rates=pick)
        columns = {name: at.column(names[k]) for name, k in zip(names, order)}
        orders: dict[str, Any] = {"joint_positions.columns": columns}
        if has_rates:
            columns = {name: rate_at.column(names[k]) for name, k in zip(names, order)}
            orders["joint_rates.columns"] = columns
        if column_map.reversed_joints:
            is_reversed = [names[k] in column_map.reversed_joints for k in order]
            orders["reversed_joints"] = [n for n, yes in zip(names, is_reversed) if yes]
        yield text, log, orders


def _orders(names: tuple[str, ...], rotors: NDArray[np.bool_]) -> Iterator[tuple[str, list[int]]]:
    """Yield other orders of the joints that are no rotors, in words and as places of the log's.

    They are exchanges of two, and all orders of four or fewer.
    """
    moving, count = np.flatnonzero(~rotors).tolist(), len(names)
    for a, b in combinations(moving, 2):
        order = list(range(count))
        order[a], order[b] = b, a
        yield f"the joints q:{names[a]} and q:{names[b]} are exchanged", order
    usual = {tuple(moving[::-1]): "the joints are numbered from the tip"}
    if count > 2 and count % 2 == 0 and len(moving) == count:
        first, second = moving[: count // 2], moving[count // 2 :]
        text = f"the joints {names[0]} … and {names[second[0]]} … of two arms are exchanged"
        usual.setdefault((*second, *first), text)
    for places in usual if len(moving) > 4 else permutations(moving):
        order = list(range(count))
        for k, place in zip(moving, places):
            order[k] = place
        if sum(k != place for k, place in enumerate(order)) > 2:
            text = f"the joints are in the order {', '.join(names[k] for k in order)}"
            yield usual.get(places, text), order


def _places(
    given: Instants, tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Reading]:
    """Yield units, points and frames of the position and the velocity."""
    at, speed = column_map.position, column_map.velocity
    R_WB, spin, text = given.R_WB, given.turning, "the position is"
    has_position = "position" in given.values
    scaled = [
        ("", given, {}),
        *_units(given, text, "position.unit", at.unit, _LENGTHS, "position"),
    ]
    for unit, log, entries in scaled if has_position else ():
        if unit:
            unit += ", or masses of the model are wrong"
            yield unit, log, entries
        if tree is None or spin is None:
            continue
        explained = explain_by_momentum(log, tree, has_free_point=True)
        if (
            explained is None
            or explained.comparison.residual >= 1
            or np.linalg.norm(explained.point_B) < UNEXPLAINED_DISTANCE * explained.reach
        ):
            continue
        place = np.round(at.point_B + explained.point_B, 4).tolist()
        of_point = (
            f"the position is that of the point {plain(place)} m in B instead of B's origin, or "
            "the model's base has another mass or centre of mass"
        )
        moved = _with_position(
            log,
            log.values["position"] - rotate(R_WB, explained.point_B),
            log.rates["position"] - rotate(R_WB, np.cross(spin, explained.point_B)),
        )
        texts = [unit, of_point] if unit else [of_point]
        yield "; and ".join(texts), moved, {**entries, "position.point_B": place}
    if has_position and spin is not None:
        p, p_rate = given.values["position"], given.rates["position"]
        in_W = rotate(R_WB, p), rotate(R_WB, p_rate + np.cross(spin, p))
        text = "the position is expressed in B's axes: it must be in W's axes"
        yield text, _with_position(given, *in_W), {}
    if "velocity" not in given.values:
        return
    yield from _units(given, "the velocity is", "velocity.unit", speed.unit, _SPEEDS, "velocity")
    if "attitude" in given.values:
        is_in_W = speed.frame != "body"
        text = f"the velocity is expressed in {'B' if is_in_W else 'W'}'s axes"
        R = R_WB if is_in_W else np.swapaxes(R_WB, 1, 2)
        entries = {"velocity.frame": "body" if is_in_W else "world"}
        yield text, given.changed(velocity=partial(rotate, R)), entries


def _with_position(given: Instants, p: Array, rate: Array) -> Instants:
    values, rates = {**given.values, "position": p}, {**given.rates, "position": rate}
    return replace(given, values=values, rates=rates)
