"""Names the convention of a log that its model does not share, if one alone explains the motion.

All candidates have one score: what the conservation of momentum leaves unexplained, as a share of
the motion, with a free target and momentum. Angular momentum about the centre of mass is linear in
the target (`RELATIVE_ROWS`), and so are the base's velocities, or its positions
(`logs.centre_of_mass`). The score is the geometric mean of both shares. The right
convention leaves noise, all others much more. Errors of any size (delays, scales, zeros, masses)
are no conventions: the fit compares them by evidence.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RELATIVE_ROWS, STANDARD_ROWS
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.estimation.momentum_rows import momentum_rows
from cpid_drake.identification.by_rows import complete_samples
from cpid_drake.logs.centre_of_mass import BaseTravel, TravelModel
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.logs.smoothing import smooth
from cpid_drake.sensors.sensors import POSITION, VELOCITY
from cpid_drake.sensors.suite import SensorSuite

LONGEST = 60.0
"""Length of the part of a log that is examined [s]."""

EXPLAINS = 0.05
"""Largest score of a convention that explains the motion."""

CLEARLY = 3.0
"""Ratio of scores from which one convention explains the motion clearly better than another."""

_INSTANTS = 150  # of the motion that are compared
_EDGE = 0.05  # share of a smoothed motion at each end where its rates are less accurate
_ROUNDING = 1e-12  # share up to which residuals are errors of the arithmetic
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": 0.3048}
_TURNS = {"degrees per second": np.pi / 180, "revolutions per minute (rpm)": np.pi / 30}

Array = NDArray[np.float64]
Candidate = tuple[str, KinematicTree, Telemetry]
"""A convention as a sentence, and the tree and the motion that would be right."""


def convention_of(
    tree: KinematicTree, measurements: Measurements, sensors: SensorSuite | None = None
) -> str | None:
    """Return the convention that explains a log whose checks fail, as a sentence.

    Args:
        tree: the known spacecraft.
        measurements: screened samples, joints in the spacecraft's order; the first minute is used.
        sensors: the sensors' errors; None if they are not known.

    Returns:
        None if the conventions as read are as good as any, if no convention or more than one
        explains the motion, or if the motion cannot be compared.

    """
    if tree.normal_B is not None:  # the plane's few equations do not tell conventions apart
        return None
    start = min((s.time[0] for _, s in measurements.items() if len(s)), default=0.0)
    measurements = measurements.between(start, start + LONGEST)
    tree, has_attitude = tree.lumped, len(measurements.attitude) > 0
    place = VELOCITY if len(measurements.velocity) and has_attitude else None
    motion = complete_samples(measurements, STANDARD_ROWS if place else RELATIVE_ROWS)
    has_rates = motion is not None
    if motion is None:
        place = POSITION if len(measurements.position) else None
        try:
            suite = sensors or estimate_suite(measurements)
            motion = smooth(measurements, suite, with_position=place is not None).telemetry
        except (InputError, np.linalg.LinAlgError, ValueError):
            return None  # too few samples, or samples that cannot be smoothed
        edge = int(_EDGE * len(motion))
        motion = motion.select(slice(edge, len(motion) - edge))
    if len(motion) < len(tree.unknowns) + RELATIVE_ROWS.momentum_size:
        return None
    motion = motion.select(slice(0, None, -(-len(motion) // _INSTANTS)))
    momentum = TotalMomentum.unknown() if has_attitude else TotalMomentum.zero()

    def score(tree: KinematicTree, motion: Telemetry) -> float:
        angular = _unexplained(momentum_rows(tree, motion, RELATIVE_ROWS, momentum))
        if place is None:
            return angular
        if place is VELOCITY:
            rows = momentum_rows(tree, motion, STANDARD_ROWS, momentum)
            rows = rows.reshape(len(motion), 6, -1)[:, :3].reshape(3 * len(motion), -1)
            return float(np.sqrt(angular * _unexplained(rows)))
        travel = BaseTravel(motion.time - motion.time[0], motion.p_WB, motion.R_WB, motion.q)
        fit = TravelModel(tree, motion.q).fit(travel)
        return float(np.sqrt(angular * fit.error)) if fit.is_possible else np.inf

    candidates = [*_of_joints(tree, motion), *_of_capture(tree, motion)]
    if has_rates:
        candidates += _of_rates(tree, motion, has_velocity=place is VELOCITY)
    if has_rates and has_attitude:
        candidates += _of_frames(tree, motion, has_velocity=place is VELOCITY)
    if has_attitude:
        candidates += _of_axes(tree, motion, has_place=place is not None)
    scores = {text: score(other, moved) for text, other, moved in candidates}
    text, *others = sorted(scores, key=lambda text: scores[text])
    rest = min(score(tree, motion), *(scores[other] for other in others[:1]))
    is_clear = CLEARLY * scores[text] < rest
    return text if is_clear and scores[text] < EXPLAINS else None


def _unexplained(rows: Array) -> float:
    """Return the residuals of rows [A | b] as a share of b.

    Errors of the arithmetic tell nothing: all shares below 1e-12 are returned as 1e-12.
    """
    size = np.linalg.norm(rows, axis=0)
    A, b = rows[:, :-1] / np.where(size[:-1] > 0, size[:-1], 1.0), rows[:, -1]
    x = np.linalg.lstsq(A, b, rcond=1e-10)[0]
    return max(float(np.linalg.norm(b - A @ x)) / max(float(size[-1]), 1e-300), _ROUNDING)


def _of_joints(tree: KinematicTree, motion: Telemetry) -> Iterator[Candidate]:
    names, count = motion.joint_names, len(motion.joint_names)
    moving = [k for k in range(count) if not tree.is_rotor(k)]
    for k in moving:
        signs = np.where(np.arange(count) == k, -1.0, 1.0)
        moved = replace(motion, q=signs * motion.q, qdot=signs * motion.qdot)
        yield f"q:{names[k]} has the opposite sign of the model's joint", tree, moved
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
        yield text, tree, replace(motion, q=motion.q[:, order], qdot=motion.qdot[:, order])


def _of_capture(tree: KinematicTree, motion: Telemetry) -> Iterator[Candidate]:
    for k, body in enumerate(tree.bodies):
        if body.parent >= 0 and k != tree.capture_body:
            held = replace(tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
            text = f"the body '{body.name}' of the model, not the capture frame, holds the target"
            yield text, held, motion


def _of_rates(tree: KinematicTree, motion: Telemetry, *, has_velocity: bool) -> Iterator[Candidate]:
    """Yield units of rates that were measured: rates of a smoothed motion have none."""
    rotors = np.array([tree.is_rotor(k) for k in range(len(motion.joint_names))], dtype=bool)
    for unit, size in _TURNS.items():
        ending = f"in {unit}: they must be in rad/s"
        turned = replace(motion, w_WB=size * motion.w_WB)
        yield f"the angular velocity is in {unit}: it must be in rad/s", tree, turned
        yield f"the joint rates are {ending}", tree, replace(motion, qdot=size * motion.qdot)
        if rotors.any():
            spun = replace(motion, qdot=np.where(rotors, size, 1.0) * motion.qdot)
            yield f"the wheels' rates are {ending}", tree, spun
    for unit, size in _LENGTHS.items() if has_velocity else ():
        text = f"the velocity is in {unit} per second: it must be in m/s"
        yield text, tree, replace(motion, v_WB=size * motion.v_WB)


def _of_frames(
    tree: KinematicTree, motion: Telemetry, *, has_velocity: bool
) -> Iterator[Candidate]:
    """Yield frames of rates that were measured."""
    R_WB = motion.R_WB
    text = "the angular velocity is expressed in W's axes, not in B's"
    yield text, tree, replace(motion, w_WB=rotate(np.swapaxes(R_WB, -1, -2), motion.w_WB))
    if has_velocity:
        text = "the velocity is expressed in B's axes: it must be in W's axes"
        yield text, tree, replace(motion, v_WB=rotate(R_WB, motion.v_WB))


def _of_axes(tree: KinematicTree, motion: Telemetry, *, has_place: bool) -> Iterator[Candidate]:
    R_WB = motion.R_WB

    def placed(M: Array) -> Telemetry:
        return replace(motion, p_WB=motion.p_WB @ M.T, v_WB=motion.v_WB @ M.T)

    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        M = np.zeros((3, 3))
        M[range(3), order] = signs
        if np.array_equal(M, np.eye(3)):
            continue
        axes = ", ".join(("-" if s < 0 else "") + "xyz"[k] for k, s in zip(order, signs))
        if np.linalg.det(M) > 0:
            text = "attitude and angular velocity belong to other axes of the base than the model's"
            turned = replace(motion, quaternion_WB=_quaternions(R_WB @ M.T))
            yield f"{text}: their {axes} are x, y, z", tree, turned
        if has_place:
            text = "the position is expressed in other axes than the attitude"
            yield f"{text}: its {axes} are x, y, z", tree, placed(M)
    for axis, name in enumerate("xyz" if has_place else ""):
        M = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
        turned = replace(placed(M), quaternion_WB=_quaternions(M @ R_WB @ M), w_WB=-motion.w_WB @ M)
        yield f"the axes are left-handed: the log is mirrored along {name}", tree, turned


def _quaternions(R: Array) -> Array:
    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))
