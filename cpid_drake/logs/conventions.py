"""Finds the conventions that explain a log better than those in which it is read.

An alternative differs from the given map of columns in one convention: a unit, an order or a
direction of the attitude, axes, a sign, the clock, or which joint is which. All have one score, the
comparisons of `logs.score`. The right convention leaves noise, all others leave much more. Errors
of any size (delays, scales, zeros, masses) are no conventions: a fit compares them by evidence.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.column_map import QUATERNION_ORDERS, ColumnMap, scale_of
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.score import (
    MOMENTUM,
    Comparison,
    Instants,
    centre_of_mass,
    compare,
    compare_momentum,
    compare_rates,
    instants_of,
)

EXPLAINS = 0.05
"""Largest residual of the momentum that a right convention leaves; smoothing leaves less."""

AGREES = 0.2
"""Largest residual of rates that agree with positions; another unit, axis or sign leaves 0.5."""

DIFFERS = 0.5
"""Residual of positions and rates that are of different motions."""

CLEARLY = 3.0
"""Ratio of residuals from which one convention explains a log clearly better than another."""

FAR = 0.05
"""Distance of a point from B's origin, in reaches of the arm, that model errors do not explain."""

_TIES = 3  # alternatives that explain a log equally well and are still a help
_WORSE = 1.5  # ratio of residuals from which an alternative contradicts a comparison
_WORDS = {
    **{"mm": "millimetres", "cm": "centimetres", "km": "kilometres", "m": "metres"},
    **{"in": "inches", "ft": "feet", "deg": "degrees", "rad": "radians", "mrad": "milliradians"},
    **{"rpm": "revolutions per minute", "s": "seconds", "ms": "milliseconds"},
    **{"us": "microseconds", "ns": "nanoseconds"},
}
_LENGTHS = ("m", "mm", "cm", "in", "ft")
_TURNS = ("rad/s", "deg/s", "rpm")

Array = NDArray[np.float64]
Change = Callable[[Instants], Instants]


@dataclass(frozen=True, eq=False)
class Alternative:
    """A log read in one other convention.

    Attributes:
        text: what is then wrong in the log as read, in words.
        log: what the log then says.
        tree: the known spacecraft.
        entries: by key of the map of columns, with dots, the values that read the log so; empty if
            no map can.

    """

    text: str
    log: Instants
    tree: KinematicTree | None
    entries: Mapping[str, Any]

    @property
    def is_point(self) -> bool:
        """Whether the position is that of another point, and nothing else is different."""
        return [*self.entries] == ["position.point_B"]

    @property
    def sentence(self) -> str:
        """What is wrong, and the remedy."""
        if not self.entries:
            return self.text
        remedy = ", ".join(f"{key}: {_plain(value)}" for key, value in self.entries.items())
        return f"{self.text} ({remedy} in a map of columns)"


@dataclass(frozen=True, eq=False)
class Findings:
    """What the comparisons of a log say.

    Attributes:
        comparisons: all that are possible.
        better: alternatives that explain the log clearly better than the conventions it is read in.
        unchecked: what could not be compared, each with the reason.

    """

    comparisons: tuple[Comparison, ...] = ()
    better: tuple[Alternative, ...] = ()
    unchecked: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The convention that explains the log better, and the remedy; empty without one."""
        return ", or ".join(each.sentence for each in self.better)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The point of the position: the spacecraft may differ from its model instead."""
        return (self.sentence,) if self.better and self.better[0].is_point else ()

    @property
    def failures(self) -> tuple[str, ...]:
        """Contradictions in the log, as sentences: the convention, or quantities that differ."""
        if self.better:
            return () if self.warnings else (self.sentence,)
        return tuple(
            f"{c.sides[0]} and {c.sides[1]} differ by {c.residual:.0%}, in any convention"
            for c in self.comparisons
            if c.name != MOMENTUM and c.residual > DIFFERS
        )


def check_conventions(
    log: Measurements, tree: KinematicTree | None, *, is_bad: bool = False
) -> Findings:
    """Compare the quantities of a log with each other, and with what the momentum allows.

    Args:
        log: screened samples, joints in the spacecraft's order.
        tree: the known spacecraft; None to compare positions with rates only.
        is_bad: whether to look for another convention in any case, as after a bad fit; else only if
            a comparison fails.

    """
    given = instants_of(log)
    if given is None:
        return Findings(unchecked=("units, signs and frames (too few samples)",))
    found = compare(given, log.joint_names, tree)
    failed = [c for c in found if c.residual > (EXPLAINS if c.name == MOMENTUM else AGREES)]
    better: list[Alternative] = []
    if failed or is_bad:
        column_map = log.column_map or ColumnMap()
        better = better_conventions(given, log.joint_names, tree, column_map)
    unchecked = []
    momentum = next((c for c in found if c.name == MOMENTUM), None)
    if tree is None:
        unchecked.append("units of position, its point, signs of joints (needs --spacecraft)")
    elif momentum is None:
        unchecked.append("unit and point of the position, signs of joints (no motion to compare)")
    elif momentum in failed and not better:
        unchecked.append(
            "unit and point of the position, signs of joints (momentum leaves "
            f"{min(momentum.residual, 1.0):.0%} of the motion unexplained, as errors of a clock, "
            "of a joint or of the model's masses do)"
        )
    return Findings(tuple(found), tuple(better), tuple(unchecked))


def better_conventions(
    given: Instants, names: tuple[str, ...], tree: KinematicTree | None, column_map: ColumnMap
) -> list[Alternative]:
    """Return the alternatives that explain a log clearly better than the conventions it is read in.

    Args:
        given: what the log says as read.
        names: the joints.
        tree: the known spacecraft.
        column_map: the map it is read with.

    Returns:
        The best first, and others that explain the log equally well; empty if no alternative
        explains it clearly better, or too many do.

    """
    tree = None if tree is None else tree.lumped
    now, rows = _residuals(given, names, tree), []
    for each in alternatives(given, names, tree, column_map):
        rates = {c.name: c.residual for c in compare_rates(each.log, names)}
        if any(_contradicts(now, name, value) for name, value in rates.items()):
            continue
        momentum = [] if each.tree is None else compare_momentum(each.log, each.tree)
        then = {**rates, **{c.name: c.residual for c in momentum}}
        better = {n for n, value in then.items() if CLEARLY * value < now.get(n, 0.0)}
        explained = all(then[n] < (EXPLAINS if n == MOMENTUM else AGREES) for n in better)
        worse = any(_contradicts(now, name, value) for name, value in then.items())
        if better and explained and not worse:
            rows.append((sum(np.log(value) for value in then.values()), each))
    if not rows:
        return []
    rows.sort(key=lambda row: row[0])
    best = [each for total, each in rows if total < rows[0][0] + np.log(CLEARLY)]
    return best if len(best) <= _TIES else []


def _residuals(
    given: Instants, names: tuple[str, ...], tree: KinematicTree | None
) -> dict[str, float]:
    return {each.name: each.residual for each in compare(given, names, tree)}


def _contradicts(now: Mapping[str, float], name: str, value: float) -> bool:
    return bool(value > _WORSE * now.get(name, np.inf) and value > EXPLAINS)


def alternatives(
    given: Instants, names: tuple[str, ...], tree: KinematicTree | None, column_map: ColumnMap
) -> Iterator[Alternative]:
    """Yield the log in every other convention; see `better_conventions`."""

    def read(text: str, entries: Mapping[str, Any], **changed: Any) -> Alternative:
        return Alternative(text, replace(given, **changed), tree, entries)

    yield from _clocks(given, column_map, read)
    yield from _joints(given, names, tree, column_map, read)
    yield from _attitudes(given, column_map, read)
    yield from _places(given, tree, column_map, read)
    for k, body in enumerate(() if tree is None else tree.bodies):
        assert tree is not None
        if body.parent >= 0 and k != tree.capture_body:
            held = replace(tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
            text = f"the body '{body.name}' of the model, not the capture frame, holds the target"
            yield Alternative(text, given, held, {})


Read = Callable[..., Alternative]


def _clocks(given: Instants, column_map: ColumnMap, read: Read) -> Iterator[Alternative]:
    now = column_map.time.unit
    for unit in ("s", "ms", "us", "ns") if now != "frame" else ():
        if unit != now:
            size = scale_of(unit) / scale_of(now)
            text = f"positions and rates agree if the time is in {_WORDS[unit]}"
            yield read(text, {"time.unit": unit}, **_slower(given, size))


def _slower(given: Instants, size: float) -> dict[str, Any]:
    """Return what a log says if its time runs `size` times as fast."""
    rates = {
        name: None if getattr(given, name) is None else getattr(given, name) / size
        for name in ("q_rate", "p_rate", "quaternion_rate")
    }
    return {"time": size * given.time, **rates}


def _joints(
    given: Instants,
    names: tuple[str, ...],
    tree: KinematicTree | None,
    column_map: ColumnMap,
    read: Read,
) -> Iterator[Alternative]:
    count = len(names)
    rotors, sliding = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    if tree is not None:
        rotors[:] = [tree.is_rotor(k) for k in range(count)]
        sliding[[body.joint for body in tree.bodies if body.joint >= 0 and body.prismatic]] = True
    groups = [("", ~sliding), ("wheels' ", rotors)] if not sliding.all() else []
    groups += [(name, np.arange(count) == k) for k, name in enumerate(names)]
    at, rate_at = column_map.joint_positions, column_map.joint_rates
    for label, chosen in groups:
        if not chosen.any():
            continue
        is_one = label in names
        first = int(np.flatnonzero(chosen)[0])
        slides = bool(sliding[first])
        units, now = _LENGTHS if slides else ("rad", "deg"), at.units.get(names[first], at.unit)
        now = "m" if slides and now == "rad" else now
        key = f"joint_positions.units.{label}" if is_one else "joint_positions.unit"
        rate_keys = [key.replace("positions", "rates")]
        if label == "wheels' ":
            rate_keys = [f"joint_rates.units.{names[k]}" for k in np.flatnonzero(chosen)]
        what = f"q:{label} is" if is_one else f"the {label}joint positions are"
        whats = f"qd:{label} is" if is_one else f"the {label}joint rates are"
        for unit in units if label != "wheels' " else ():
            if unit == now:
                continue
            size = np.where(chosen, scale_of(unit) / scale_of(now), 1.0)
            moved = {"q": size * given.q, "q_rate": size * given.q_rate}
            word = _WORDS[unit]
            yield read(f"{what} in {word}", {key: unit}, **moved)
            if given.qdot is not None:
                text = f"{what.removesuffix(' is').removesuffix(' are')} and their rates are"
                entries = {key: unit, rate_keys[0]: f"{unit}/s"}
                yield read(f"{text} in {word}", entries, **moved, qdot=size * given.qdot)
        if given.qdot is None:
            continue
        rate_now = rate_at.units.get(names[first], rate_at.unit)
        rate_now = "m/s" if slides and rate_now == "rad/s" else rate_now
        for unit in [f"{u}/s" for u in _LENGTHS] if slides else _TURNS:
            if unit != rate_now:
                size = np.where(chosen, scale_of(unit) / scale_of(rate_now), 1.0)
                word = _WORDS[unit.removesuffix("/s")] + (" per second" if "/" in unit else "")
                entries = dict.fromkeys(rate_keys, unit)
                yield read(f"{whats} in {word}", entries, qdot=size * given.qdot)
        if label != "wheels' ":
            opposite = np.where(chosen if is_one else True, -1.0, 1.0) * given.qdot
            text = f"qd:{label} is the rate of q:{label} with the opposite sign"
            if not is_one:
                text = "the joint rates have the opposite sign of the positions' changes"
            yield read(text, {}, qdot=opposite)
    moving = [k for k in range(count) if not rotors[k]]
    for k in moving:
        signs = np.where(np.arange(count) == k, -1.0, 1.0)
        text = f"q:{names[k]} has the opposite sign of the model's joint"
        flipped: dict[str, Any] = {name: signs * getattr(given, name) for name in ("q", "q_rate")}
        flipped["qdot"] = None if given.qdot is None else signs * given.qdot
        yield read(text, {"reversed_joints": [names[k]]}, **flipped)
    orders = {}
    for a, b in combinations(moving, 2):
        order = list(range(count))
        order[a], order[b] = b, a
        orders[f"the joints q:{names[a]} and q:{names[b]} are exchanged"] = order
    if count > 2 and count % 2 == 0 and len(moving) == count:
        half = count // 2
        text = f"the joints {names[0]} … and {names[half]} … of two arms are exchanged"
        orders[text] = [*range(half, count), *range(half)]
    for text, order in orders.items():
        moved = {name: getattr(given, name)[:, order] for name in ("q", "q_rate")}
        yield read(text, {}, **moved, qdot=None if given.qdot is None else given.qdot[:, order])


def _attitudes(given: Instants, column_map: ColumnMap, read: Read) -> Iterator[Alternative]:
    """Yield orders and directions of the attitude, and units, frames and axes of the gyro."""
    at, gyro, w_B = column_map.attitude, column_map.angular_velocity, given.w_B
    now = gyro.unit
    units = _TURNS if w_B is not None else (now,)
    if given.quaternion is None or given.quaternion_rate is None:
        for unit in units:
            if unit != now and w_B is not None:
                size = scale_of(unit) / scale_of(now)
                text = f"the angular velocity is in {_turns(unit)}"
                yield read(text, {"angular_velocity.unit": unit}, w_B=size * w_B)
        return
    frame_now = "world" if gyro.frame == "world" else "body"
    frames = ("body", "world") if w_B is not None else (frame_now,)
    is_plain = at.order in QUATERNION_ORDERS and np.array_equal(at.R_BS, np.eye(3))
    orders = QUATERNION_ORDERS if is_plain else (at.order,)
    in_world = None if w_B is None else rotate(given.R_WB, w_B)  # as logged, if it is in W
    for order, direction, frame, unit in product(orders, ("R_WB", "R_BW"), frames, units):
        if (order, direction, frame, unit) == (at.order, at.direction, frame_now, now):
            continue
        moved: dict[str, Any] = {
            name: _reordered(getattr(given, name), at.order, order, direction != at.direction)
            for name in ("quaternion", "quaternion_rate")
        }
        texts, entries = [], {}
        if order != at.order:
            entries["attitude.order"] = order
            texts.append(f"the quaternion is in the order {', '.join(order)}")
        if direction != at.direction:
            entries["attitude.direction"] = direction
            texts.append(f"the attitude is that of {direction}, not of {at.direction}")
        if w_B is not None and in_world is not None:
            logged = in_world if frame_now == "world" else w_B
            there = replace(given, **moved)
            back = np.swapaxes(there.R_WB, 1, 2)
            turned = rotate(back, logged) if frame == "world" else logged
            moved["w_B"] = scale_of(unit) / scale_of(now) * turned
        if frame != frame_now:
            entries["angular_velocity.frame"] = frame
            axes = "W's axes, not in B's" if frame == "world" else "B's axes, not in W's"
            texts.append(f"the angular velocity is expressed in {axes}")
        if unit != now:
            entries["angular_velocity.unit"] = unit
            texts.append(f"the angular velocity is in {_turns(unit)}")
        yield read("; and ".join(texts), entries, **moved)
    for letters, M in _signed_axes():
        if np.linalg.det(M) > 0:
            text = "attitude and angular velocity belong to other axes of the base than the model's"
            turn = Rotation.from_matrix(M).inv()
            moved = {
                "quaternion": _turned(given.quaternion, turn),
                "quaternion_rate": _turned(given.quaternion_rate, turn),
                "w_B": None if w_B is None else w_B @ M.T,
            }
            entries = {"attitude.R_BS": (M @ at.R_BS).tolist()}
            if w_B is not None:
                entries["angular_velocity.R_BS"] = (M @ gyro.R_BS).tolist()
            yield read(f"{text}: their {', '.join(letters)} are x, y, z", entries, **moved)
        if w_B is not None:
            text = f"the gyro has other axes than the base: its {', '.join(letters)} are x, y, z"
            entries = {"angular_velocity.R_BS": (M @ gyro.R_BS).tolist()}
            yield read(text, entries, w_B=w_B @ M.T)


def _places(
    given: Instants, tree: KinematicTree | None, column_map: ColumnMap, read: Read
) -> Iterator[Alternative]:
    """Yield units, points and axes of the position and the velocity, and mirrored logs."""
    R_WB, p, p_rate, v = given.R_WB, given.p, given.p_rate, given.v
    has_attitude = given.quaternion is not None

    def placed(M: Array) -> dict[str, Any]:
        return {
            name: None if value is None else value @ M.T
            for name, value in (("p", p), ("p_rate", p_rate), ("v", v))
        }

    if p is not None and p_rate is not None:
        now = column_map.position.unit
        for unit in (now, *(u for u in _LENGTHS if u != now)):
            size = scale_of(unit) / scale_of(now)
            entries = {} if unit == now else {"position.unit": unit}
            scaled: dict[str, Any] = {"p": size * p, "p_rate": size * p_rate}
            texts = [f"the position is in {_WORDS[unit]}, or masses of the model are wrong"]
            if unit != now:
                yield read(texts[0], entries, **scaled)
            found = None
            if tree is not None:
                found = centre_of_mass(replace(given, **scaled), tree, has_free_point=True)
            if found is None or not found.is_possible:
                continue
            point, spin = found.point_B, given.turning
            if spin is None or np.linalg.norm(point) < FAR * found.reach:
                continue
            place = np.round(column_map.position.point_B + point, 4).tolist()
            texts.append(
                f"the position is that of the point {_plain(place)} m in B instead of B's origin, "
                "or the model's base has another mass or centre of mass"
            )
            moved = {"p": scaled["p"] - rotate(R_WB, point)}
            moved["p_rate"] = scaled["p_rate"] - rotate(R_WB, np.cross(spin, point))
            text = "; and ".join(texts[unit == now :])
            yield read(text, {**entries, "position.point_B": place}, **moved)
        if has_attitude:
            text = "the position is expressed in B's axes: it must be in W's axes"
            spin = given.turning
            assert spin is not None  # there is an attitude
            rate = rotate(R_WB, p_rate + np.cross(spin, p))
            yield read(text, {}, p=rotate(R_WB, p), p_rate=rate)
    if v is not None:
        frame = column_map.velocity.frame
        for length in _LENGTHS:
            if f"{length}/s" != column_map.velocity.unit:
                size = scale_of(length) / scale_of(column_map.velocity.unit)
                text = f"the velocity is in {_WORDS[length]} per second"
                yield read(text, {"velocity.unit": f"{length}/s"}, v=size * v)
        if has_attitude:
            is_in_W = frame == "world"
            text = f"the velocity is expressed in {'B' if is_in_W else 'W'}'s axes"
            turned = rotate(R_WB if is_in_W else np.swapaxes(R_WB, 1, 2), v)
            yield read(text, {"velocity.frame": "body" if is_in_W else "world"}, v=turned)
    if not has_attitude or (p is None and v is None):
        return
    for axes, M in _signed_axes():
        text = "the position is expressed in other axes than the attitude"
        yield read(f"{text}: its {', '.join(axes)} are x, y, z", {}, **placed(M))
    for k, name in enumerate("xyz"):
        M = np.diag(np.where(np.arange(3) == k, -1.0, 1.0))
        signs = np.where(np.append(True, np.arange(3) == k), 1.0, -1.0)
        moved = placed(M) | {
            "quaternion": given.quaternion * signs,
            "quaternion_rate": given.quaternion_rate * signs,
            "w_B": None if given.w_B is None else -given.w_B @ M,
        }
        yield read(f"the axes are left-handed: the log is mirrored along {name}", {}, **moved)


def _reordered(given: Array, now: str, order: str, is_inverse: bool) -> Array:
    """Return quaternions or their rates as read in another order and direction."""
    conjugate = np.array([1.0, -1.0, -1.0, -1.0])
    if order != now:  # the entries of the file: scalar first or last
        given = given[:, [3, 0, 1, 2] if order == "xyzw" else [1, 2, 3, 0]]
    return given * conjugate if is_inverse else given


def _turned(quaternion: Array, turn: Rotation) -> Array:
    """Return quaternions, or their rates, of R_WB turned by a constant rotation in B."""
    a0, a = quaternion[:, :1], quaternion[:, 1:]
    b = turn.as_quat(scalar_first=True)
    vector = a0 * b[1:] + b[0] * a + np.cross(a, b[1:])
    return np.hstack([a0 * b[0] - a @ b[1:, None], vector])


def _signed_axes() -> Iterator[tuple[list[str], Array]]:
    """Yield all other axes, and the matrix M with M v the vector v in these axes."""
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        M = np.zeros((3, 3))
        M[range(3), order] = signs
        if not np.array_equal(M, np.eye(3)):
            yield [("-" if s < 0 else "") + "xyz"[k] for k, s in zip(order, signs)], M


def _turns(unit: str) -> str:
    return "revolutions per minute (rpm)" if unit == "rpm" else f"{_WORDS[unit[:-2]]} per second"


def _plain(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
