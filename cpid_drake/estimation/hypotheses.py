"""Possible causes of a log that contradicts the conservation of momentum."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.parameterizations import vector_to_tensor
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.rows import inertia_operator
from cpid_drake.dynamics.spatial_inertia import point_mass_inertia
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.priors import psi_scale
from cpid_drake.estimation.momentum_balance import Hypothesis

Array = NDArray[np.float64]

_WRONG = 0.1
"""σ of an error of a body's mass properties, as a share of those of the whole spacecraft."""

_KEPT = 1e-3
"""σ of a mass that does not change, as a share of it."""

_IMPOSSIBLE = 0.5
"""Violation of the triangle inequality, as a share of the largest moment of a body with errors."""

_MOST_EXCHANGED = 16
"""Largest number of joints of which all pairs are exchanged."""


def hypotheses(tree: KinematicTree, motion: Telemetry, whole: Telemetry) -> Iterator[Hypothesis]:
    """Yield possible causes, each with the motion or the tree that would be right.

    Args:
        tree: the known spacecraft, welded bodies joined (`KinematicTree.lumped`).
        motion: N smoothed samples.
        whole: the same motion with samples before and after, for hypotheses of wrong times.

    """
    yield from _of_joints(tree, motion)
    yield from _of_clocks(tree, motion, whole)
    yield from _of_axes(tree, motion)
    yield from _of_forces(tree, motion)
    yield from _of_bodies(tree, motion)


def _of_joints(tree: KinematicTree, motion: Telemetry) -> Iterator[Hypothesis]:
    count = len(motion.joint_names)
    rotors = [k for k in range(count) if tree.is_rotor(k)]
    moving = [k for k in range(count) if k not in rotors]
    for k in moving:
        yield from _of_joint(tree, motion, k)
    for k in rotors:
        yield _of_wheel(tree, motion, k)
    if len(moving) <= _MOST_EXCHANGED:
        for a, b in combinations(moving, 2):
            yield _exchanged(tree, motion, a, b)
    if not rotors and count % 2 == 0 and count > 2:
        half, names = count // 2, motion.joint_names
        order = [*range(half, count), *range(half)]
        changed = replace(motion, q=motion.q[:, order], qdot=motion.qdot[:, order])
        yield Hypothesis(
            lambda p: f"the joints {names[0]} … and {names[half]} … of two arms are exchanged",
            lambda p: (tree, changed),
        )


def _of_joint(tree: KinematicTree, motion: Telemetry, k: int) -> Iterator[Hypothesis]:
    name = motion.joint_names[k]
    yield Hypothesis(
        lambda p: f"q:{name} has the opposite sign of the model's joint",
        lambda p: (tree, _scaled_joint(motion, k, -1.0)),
    )
    yield Hypothesis(
        lambda p: (
            f"the zero of q:{name} is {abs(p[0]):.3g} rad ({np.degrees(abs(p[0])):.2g} deg) from "
            "that of the model's joint"
        ),
        lambda p: (tree, _scaled_joint(motion, k, 1.0, p[0])),
        size=1,
        starts=(-0.1, 0.0, 0.1),
    )
    yield Hypothesis(
        lambda p: f"q:{name} is {1 / (1 + p[0]):.3g} times the joint's motion",
        lambda p: (tree, _scaled_joint(motion, k, 1.0 + p[0])),
        size=1,
        largest=0.9,
    )


def _of_wheel(tree: KinematicTree, motion: Telemetry, k: int) -> Hypothesis:
    name = motion.joint_names[k]
    return Hypothesis(
        lambda p: (
            f"qd:{name} times the wheel's inertia is {1 / (1 + p[0]):.3g} times its momentum: the "
            "wheel's inertia in the model, or the unit of its rate"
        ),
        lambda p: (tree, _scaled_joint(motion, k, 1.0 + p[0])),
        size=1,
        largest=20.0,
    )


def _exchanged(tree: KinematicTree, motion: Telemetry, a: int, b: int) -> Hypothesis:
    names = motion.joint_names
    order = list(range(len(names)))
    order[a], order[b] = b, a
    return Hypothesis(
        lambda p: f"the joints q:{names[a]} and q:{names[b]} are exchanged",
        lambda p: (tree, replace(motion, q=motion.q[:, order], qdot=motion.qdot[:, order])),
    )


def _scaled_joint(motion: Telemetry, k: int, factor: float, offset: float = 0.0) -> Telemetry:
    q, qdot = motion.q.copy(), motion.qdot.copy()
    q[:, k] = factor * q[:, k] + offset
    qdot[:, k] *= factor
    return replace(motion, q=q, qdot=qdot)


_GROUPS = {
    "joint positions": ("q", "qdot"),
    "position": ("p_WB", "v_WB"),
    "attitude": ("quaternion_WB", "w_WB"),
}
"""The quantities of one clock, the rate last."""


def _of_clocks(tree: KinematicTree, motion: Telemetry, whole: Telemetry) -> Iterator[Hypothesis]:
    for group, names in _GROUPS.items():
        yield from _of_clock(tree, motion, whole, group, names)


def _of_clock(
    tree: KinematicTree,
    motion: Telemetry,
    whole: Telemetry,
    group: str,
    names: tuple[str, str],
) -> Iterator[Hypothesis]:
    first, last = whole.time[0], whole.time[-1]
    splines = [CubicSpline(whole.time, _continuous(whole, name)) for name in names]

    def at(times: Array, rate: float = 1.0) -> tuple[KinematicTree, Telemetry]:
        value, slope = (spline(np.clip(times, first, last)) for spline in splines)
        if group == "attitude":
            value = value / np.linalg.norm(value, axis=1, keepdims=True)
        return tree, replace(motion, **{names[0]: value, names[1]: rate * slope})

    limit = float(min(motion.time[0] - first, last - motion.time[-1]))
    yield Hypothesis(
        lambda p: (
            f"the samples of {group} are {1e3 * abs(p[0]):.3g} ms "
            f"{'late' if p[0] > 0 else 'early'}, relative to the others"
        ),
        lambda p: at(motion.time + p[0]),
        size=1,
        starts=(-0.7 * limit, 0.0, 0.7 * limit),
        largest=limit,
    )
    yield Hypothesis(
        lambda p: (
            f"the clock of {group} is {100 * abs(p[0]):.3g} % "
            f"{'fast' if p[0] > 0 else 'slow'}, relative to the others"
        ),
        lambda p: at(first + (1 + p[0]) * (motion.time - first), 1 + p[0]),
        size=1,
        largest=0.2,
    )


def _continuous(motion: Telemetry, name: str) -> Array:
    """Return a quantity; quaternions without changes of their sign."""
    value: Array = getattr(motion, name)
    if name != "quaternion_WB":
        return value
    signs = np.cumprod(np.where(np.sum(value[1:] * value[:-1], axis=1) < 0, -1.0, 1.0))
    return value * np.append(1.0, signs)[:, None]


def _of_axes(tree: KinematicTree, motion: Telemetry) -> Iterator[Hypothesis]:
    R_WB = motion.R_WB

    def moved(M: Array) -> Telemetry:
        return replace(motion, p_WB=motion.p_WB @ M.T, v_WB=motion.v_WB @ M.T)

    def turned(R: Array) -> Telemetry:
        return replace(motion, quaternion_WB=_quaternions(R_WB @ R.T))

    for M in _exchanges():
        axes = _axes_text(M)
        yield _fixed(
            f"the position is expressed in other axes than the attitude: its {axes} are x, y, z",
            tree,
            moved(M),
        )
        if np.linalg.det(M) > 0:
            yield _fixed(
                "attitude and angular velocity belong to other axes of the base than the model's: "
                f"their {axes} are x, y, z",
                tree,
                turned(M),
            )
    for axis, name in enumerate("xyz"):
        M = np.eye(3)
        M[axis, axis] = -1
        mirrored = replace(
            moved(M), quaternion_WB=_quaternions(M @ R_WB @ M), w_WB=-motion.w_WB @ M
        )
        text = f"the axes are left-handed: the log is mirrored along {name}"
        yield _fixed(text, tree, mirrored)
    yield Hypothesis(
        lambda p: (
            "the position is expressed in another world than the attitude, turned by "
            f"{np.degrees(np.linalg.norm(p)):.3g} deg about [{_numbers(p)}]"
        ),
        lambda p: (tree, moved(Rotation.from_rotvec(p).as_matrix())),
        size=3,
    )
    yield Hypothesis(
        lambda p: (
            "attitude and angular velocity belong to axes that are turned from the base's by "
            f"{np.degrees(np.linalg.norm(p)):.3g} deg about [{_numbers(p)}]"
        ),
        lambda p: (tree, turned(Rotation.from_rotvec(p).as_matrix())),
        size=3,
    )

    def at_origin(p_BQ: Array) -> tuple[KinematicTree, Telemetry]:
        arm = rotate(R_WB, p_BQ)
        v_WB = motion.v_WB - np.cross(motion.w_WB, arm)
        return tree, replace(motion, p_WB=motion.p_WB - arm, v_WB=v_WB)

    yield Hypothesis(
        lambda p: f"the position is that of the point [{_numbers(p)}] m in B, not of B's origin",
        at_origin,
        size=3,
    )


def _of_forces(tree: KinematicTree, motion: Telemetry) -> Iterator[Hypothesis]:
    _, capture = propagate(tree, motion)
    R_CW = np.swapaxes(capture.R_WC, -1, -2)
    columns = np.zeros((len(motion), 6, 6))
    columns[:, :3, 3:] = columns[:, 3:, :3] = -R_CW
    columns[:, 3:, 3:] = R_CW @ skew(capture.p_WC)
    elapsed = motion.time - motion.time[0]

    def grown(factor: Array) -> Array:
        return (columns * factor[:, None, None]).reshape(-1, 6)

    yield Hypothesis(
        lambda p: (
            f"a constant force of about [{_numbers(p[3:])}] N acts, such as a leak or gravity"
        ),
        columns=grown(elapsed),
    )
    for time in np.linspace(0.0, elapsed[-1], 27)[1:-1]:
        yield _of_firing(float(time + motion.time[0]), grown((elapsed > time).astype(float)))


def _of_firing(time: float, columns: Array) -> Hypothesis:
    return Hypothesis(
        lambda p: (
            f"a force acted at about {time:.2g} s: the momentum changed by [{_numbers(p[3:])}] N·s"
        ),
        columns=columns,
    )


def _of_bodies(tree: KinematicTree, motion: Telemetry) -> Iterator[Hypothesis]:
    bodies, capture = propagate(tree, motion)
    known = relative_dynamics(tree, motion.q[:1], np.zeros_like(motion.q[:1]))
    sizes = _WRONG * psi_scale(known.mass, known.I_K[0])
    R_CW = np.swapaxes(capture.R_WC, -1, -2)
    for k, body in enumerate(tree.bodies):
        if k == tree.capture_body:
            continue
        R_BW = np.swapaxes(bodies.R[k], -1, -2)
        v, w = rotate(R_BW, bodies.v[k]), rotate(R_BW, bodies.w[k])
        rows = np.zeros((len(motion), 6, 10))
        rows[:, :3, 0], rows[:, :3, 1:4] = v, skew(w)
        rows[:, 3:, 1:4], rows[:, 3:, 4:] = -skew(v), inertia_operator(w)
        P, L = bodies.R[k] @ rows[:, :3], bodies.R[k] @ rows[:, 3:]
        L = L + skew(bodies.r[k] - capture.p_WC) @ P  # about C's origin
        text = (
            f"mass, centre of mass or inertia of the body '{body.name}' differ from the model's, "
            "or it carries a payload that the model does not contain"
        )
        columns = np.concatenate([R_CW @ P, R_CW @ L], axis=1).reshape(-1, 10)
        free = replace(
            _fixed(text, tree, motion),
            columns=columns,
            sizes=sizes,
            weighed=partial(_with_body, tree, k, sizes[-1]),
        )
        yield free
        if body.parent < 0:
            # Light arms hardly determine the scale of all masses, so the base keeps its mass.
            kept = np.concatenate([[_KEPT * body.mass], sizes[1:]])
            yield replace(free, sizes=kept)
        if body.parent >= 0:
            held = replace(tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
            text = f"the body '{body.name}' of the model, not the capture frame, holds the target"
            yield _fixed(text, held, motion)
    for k, body in enumerate(tree.bodies):
        if body.parent >= 0 and not tree.is_rotor(body.joint):
            yield _of_place(tree, motion, k)


def _with_body(tree: KinematicTree, k: int, size: float, change: Array) -> KinematicTree | None:
    """Return the tree with a change (10,) of a body's standard vector about its centre of mass.

    Args:
        tree: the known spacecraft.
        k: index of the body.
        size: usual error of an inertia [kg·m²].
        change: of the mass, the first moment, and the inertia about the old centre of mass.

    Returns:
        None if no rigid body has the changed vector, up to errors of the fit.

    """
    body = tree.bodies[k]
    mass = body.mass + change[0]
    if not mass > 0:
        return None
    com, J = change[1:4] / mass, body.I_BBcm + vector_to_tensor(change[4:])
    moments, axes = np.linalg.eigh(J - point_mass_inertia(mass, com))
    if moments.sum() - 2 * moments[-1] < -_IMPOSSIBLE * (abs(moments[-1]) + size):
        return None
    inertia = axes * np.maximum(moments, 0.0) @ axes.T
    bodies = list(tree.bodies)
    bodies[k] = replace(body, mass=mass, p_BBcm=body.p_BBcm + com, I_BBcm=inertia)
    return replace(tree, bodies=tuple(bodies))


def _of_place(tree: KinematicTree, motion: Telemetry, k: int) -> Hypothesis:
    def moved(p: Array) -> tuple[KinematicTree, Telemetry]:
        bodies = list(tree.bodies)
        bodies[k] = replace(bodies[k], p_PF=bodies[k].p_PF + p)
        return replace(tree, bodies=tuple(bodies)), motion

    name = motion.joint_names[tree.bodies[k].joint]
    return Hypothesis(
        lambda p: (
            f"the joint {name} is {100 * np.linalg.norm(p):.2g} cm from its place in the model: "
            "the length of a link"
        ),
        moved,
        size=3,
    )


def _fixed(text: str, tree: KinematicTree, motion: Telemetry) -> Hypothesis:
    """Return a hypothesis without parameters."""
    return Hypothesis(lambda p: text, lambda p: (tree, motion))


def _exchanges() -> Iterator[Array]:
    """Yield all matrices that exchange axes and change their signs, but the identity."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = signs
            if not np.array_equal(M, np.eye(3)):
                yield M


def _axes_text(M: Array) -> str:
    """Return the axes that become x, y and z, such as "y, -x, z"."""
    texts = []
    for row in M:
        axis = int(np.abs(row).argmax())
        texts.append(("-" if row[axis] < 0 else "") + "xyz"[axis])
    return ", ".join(texts)


def _quaternions(R: Array) -> Array:
    return np.asarray(Rotation.from_matrix(R).as_quat(scalar_first=True))


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in values)
