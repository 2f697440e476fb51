"""Logs as real hardware gives them, with a known truth: an oracle in plain NumPy.

A chain of rigid bodies floats in space or on a table. Its joints move as given (or are at rest), so
the momentum [L; P] and the inertia at each instant give the velocity of the base. Momentum changes
by thrusters and by white forces of the floor; Runge and Kutta's method of fourth order integrates
it together with the pose. Each draw writes a URDF, a file of sensors and logs.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
ARCSEC = np.pi / 648000
STEP = 0.05
"""Longest step of the integration [s]."""

PLANE = [2, 3, 4]
"""Entries of [w; v] that are free on a table."""


def cross(a: Array) -> Array:
    """Return the matrices (..., 3, 3) of cross products from the left."""
    x, y, z = np.moveaxis(np.asarray(a, dtype=float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*o.shape, 3, 3)


def vector_product(a: Array, b: Array) -> Array:
    """Return a × b of vectors (..., 3), quicker than NumPy's for a few of them."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


@dataclass(eq=False)
class Body:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], in its frame."""

    mass: float
    com: Array
    inertia: Array

    @classmethod
    def drawn(cls, rng: np.random.Generator, mass: float, size: float, com: Array) -> "Body":
        """Return a turned solid box with sides of about `size` [m]."""
        sides = size * rng.uniform(0.7, 1.3, 3)
        turn = Rotation.from_rotvec(0.3 * rng.standard_normal(3)).as_matrix()
        second = turn @ np.diag(sides**2) @ turn.T * mass / 12
        return cls(mass, np.asarray(com), np.trace(second) * np.eye(3) - second)

    def parameters(self) -> Array:
        """Return m, c, and I about the centre of mass (xx, yy, zz, xy, xz, yz)."""
        entries = self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        return np.concatenate([[self.mass], self.com, entries])


@dataclass(eq=False)
class Joint:
    """A joint: its origin in the body before it, and the body behind it (None: massless)."""

    name: str
    kind: str
    axis: Array
    origin: Array
    body: Body | None = None


@dataclass(eq=False)
class Valve:
    """A thruster: where it sits, its declared force [N], and the true share of it."""

    position: Array
    direction: Array
    force: float
    share: float = 1.0
    on: str = "body"
    axes: str = "body"


@dataclass(eq=False)
class Craft:
    """A base, a chain of joints, and the target at the capture frame behind the last one."""

    base: Body
    target: Body
    joints: list[Joint] = field(default_factory=list)
    capture: Array = field(default_factory=lambda: np.zeros(3))
    planar: bool = False

    def at(self, q: Array, qdot: Array) -> tuple[Array, Array, Array, Array]:
        """Return inertia (N, 6, 6) about B's origin, momentum (N, 6) of the joints, R_BC, p_BC."""
        n = len(q)
        R, p = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
        w, v, M, h = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 6, 6)), np.zeros((n, 6))

        def add(body: Body | None) -> None:
            if body is None:
                return
            m, c = body.mass, p + R @ body.com
            J, C = R @ body.inertia @ R.swapaxes(1, 2), cross(c)
            u = v + np.cross(w, R @ body.com)
            M[:, :3, :3] += J - m * C @ C
            M[:, :3, 3:] += m * C
            M[:, 3:, :3] -= m * C
            M[:, 3:, 3:] += m * np.eye(3)
            h[:, :3] += (J @ w[..., None])[..., 0] + m * np.cross(c, u)
            h[:, 3:] += m * u

        add(self.base)
        for k, joint in enumerate(self.joints):
            axis, offset = R @ joint.axis, R @ joint.origin
            if joint.kind == "prismatic":
                offset = offset + axis * q[:, k, None]
            p, v = p + offset, v + np.cross(w, offset)
            if joint.kind == "prismatic":
                v = v + axis * qdot[:, k, None]
            else:
                w = w + axis * qdot[:, k, None]
                R = R @ Rotation.from_rotvec(q[:, k, None] * joint.axis).as_matrix()
            add(joint.body)
        p = p + R @ self.capture
        v = v + np.cross(w, R @ self.capture)
        add(self.target)
        return M, h, R, p

    def urdf(self) -> str:
        """Return the model of the known spacecraft, without the target."""

        def link(name: str, body: Body | None) -> str:
            if body is None:
                return f'<link name="{name}"/>'
            J, c = body.inertia, " ".join(f"{x:.12g}" for x in body.com)
            names = ("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2)
            inertia = " ".join(f'{n}="{J[a, b]:.12g}"' for n, a, b in (*names, ("iyz", 1, 2)))
            return (
                f'<link name="{name}"><inertial><origin xyz="{c}"/><mass value="{body.mass:.12g}"/>'
                f"<inertia {inertia}/></inertial></link>"
            )

        parts, last = [link("base", self.base)], "base"
        tail = Joint("capture", "fixed", np.array([1.0, 0, 0]), self.capture)
        for joint in [*self.joints, tail]:
            name = "capture_point" if joint.kind == "fixed" else f"{joint.name}_link"
            axis, origin = (" ".join(f"{x:.12g}" for x in v) for v in (joint.axis, joint.origin))
            moves = f'<axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="9" effort="9"/>'
            parts += [
                link(name, joint.body),
                f'<joint name="{joint.name}" type="{joint.kind}"><parent link="{last}"/>'
                f'<child link="{name}"/><origin xyz="{origin}"/>'
                f"{'' if joint.kind == 'fixed' else moves}</joint>",
            ]
            last = name
        return '<robot name="platform">\n' + "\n".join(parts) + "\n</robot>\n"


def run(
    craft: Craft,
    times: Array,
    motion: Callable[[Array], tuple[Array, Array]],
    rng: np.random.Generator,
    *,
    momentum: Array | None = None,
    valves: list[Valve] = [],  # noqa: B006
    command: Callable[[int, dict], Array] | None = None,
    delay: float = 0.0,
    loss: float = 0.0,
    floor: tuple[float, float] = (0.0, 0.0),
    push: Callable[[float], Array] = lambda t: np.zeros(3),
) -> dict[str, Array]:
    """Integrate the motion, and return it at equidistant times.

    Args:
        craft: all bodies.
        times: (N,) of the rows of the log [s].
        motion: q and qdot (M, joints) at times (M,).
        rng: draws the noise of the floor.
        momentum: (6,) [L; P] about W's origin at the start.
        valves: thrusters.
        command: opening of all valves from a row until the next, by number and present state.
        delay: from a command to its force [s].
        loss: share of the force lost for each further open valve.
        floor: white acceleration of the centre of mass [m/s²/√Hz] and torque [N·m/√Hz].
        push: acceleration (3,) of the centre of mass from outside [m/s²].

    Returns:
        quat (scalar first), p, L (about W's origin), P, w_B, v_B, and the opening of the valves.

    """
    T = times[1] - times[0]
    first, late = divmod(delay / T, 1.0)
    splits = [0.0, late * T, T] if late > 1e-9 else [0.0, T]
    inside = [
        np.linspace(a, b, max(1, int(np.ceil((b - a) / STEP))) + 1)[:-1]
        for a, b in pairwise(splits)
    ]
    early = len(inside[0]) if len(inside) == 2 else 0  # steps before the late command acts
    within = np.append(np.concatenate(inside), T)
    grid = np.append((times[:-1, None] + within[:-1]).ravel(), times[-1])
    knots = np.append(np.column_stack([grid[:-1], (grid[:-1] + grid[1:]) / 2]).ravel(), grid[-1])
    M, h_joints, R_BC, p_BC = craft.at(*motion(knots))
    free = PLANE if craft.planar else list(range(6))
    inverse = np.zeros_like(M)
    inverse[np.ix_(range(len(M)), free, free)] = np.linalg.inv(M[:, free][:, :, free])
    mass = M[0, 5, 5]
    com = np.stack([M[:, 2, 4], M[:, 0, 5], M[:, 1, 3]], axis=1) / mass
    seat = np.zeros((len(knots), len(valves), 3))
    aim = np.zeros_like(seat)  # in B, or in W for world axes
    in_world = np.array([v.axes == "world" for v in valves], dtype=bool)
    for k, valve in enumerate(valves):
        on_target = valve.on == "target"
        seat[:, k] = p_BC + R_BC @ valve.position if on_target else valve.position
        turned = on_target and valve.axes == "body"
        aim[:, k] = R_BC @ valve.direction if turned else valve.direction
    strength = np.array([v.force * v.share for v in valves])

    def rate(k: int, state: Array, u: Array, noise: Array) -> tuple[Array, Array]:
        quat, p, L, P = state[:4] / np.linalg.norm(state[:4]), state[4:7], state[7:10], state[10:]
        a, b, c, d = quat
        R = np.array(
            [
                [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
                [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
                [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
            ]
        )
        about_B = np.concatenate([(L - vector_product(p, P)) @ R, P @ R])
        V = inverse[k] @ (about_B - h_joints[k])
        turn = np.array([[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]]) @ V[:3] / 2
        force = noise[:3]
        torque = noise[3:] + vector_product(p + R @ com[k], force)
        if u.any():
            each = (u * strength)[:, None] * np.where(in_world[:, None], aim[k], aim[k] @ R.T)
            force = force + each.sum(axis=0)
            torque = torque + vector_product(p + seat[k] @ R.T, each).sum(axis=0)
        return np.concatenate([turn, R @ V[3:], torque, force]), V

    state = np.concatenate([[1.0], np.zeros(6), np.zeros(6) if momentum is None else momentum])
    count, steps = len(valves), len(within) - 1
    opening = np.zeros((len(times), count))
    rows = []
    for row in range(len(times)):
        k = 2 * row * steps
        none = np.zeros(count), np.zeros(6)
        V = rate(k, state, *none)[1]
        rows.append(np.concatenate([state, V]))
        if row == len(times) - 1:
            break
        if command is not None:
            opening[row] = command(
                row, {"state": state, "V": V, "R": rotation(state[:4]), "M": M[k]}
            )
        for j in range(steps):
            source = row - int(first) - (1 if j < early else 0)
            u = opening[source] if source >= 0 else np.zeros(count)
            u = u * max(0.0, 1 - loss * max(np.count_nonzero(u) - 1, 0))
            h = within[j + 1] - within[j]
            white = rng.standard_normal(6) * np.repeat([floor[0] * mass, floor[1]], 3) / np.sqrt(h)
            white[:3] += mass * push(times[row] + within[j] + h / 2)
            if craft.planar:
                white[2:5] = 0.0
            i = k + 2 * j
            k1 = rate(i, state, u, white)[0]
            k2 = rate(i + 1, state + h / 2 * k1, u, white)[0]
            k3 = rate(i + 1, state + h / 2 * k2, u, white)[0]
            k4 = rate(i + 2, state + h * k3, u, white)[0]
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            state[:4] /= np.linalg.norm(state[:4])
    found = np.array(rows)
    return {
        "quat": found[:, :4], "p": found[:, 4:7], "L": found[:, 7:10], "P": found[:, 10:13],
        "w_B": found[:, 13:16], "v_B": found[:, 16:19], "opening": opening,
    }  # fmt: skip


def rotation(quat: Array) -> Array:
    """Return the matrix of a quaternion, scalar first."""
    return Rotation.from_quat(quat, scalar_first=True).as_matrix()


def sines(rng: np.random.Generator, size: Array, low: float, high: float) -> Callable:
    """Return q, qdot of two sines in each joint, at rest in the mean, with amplitudes `size`."""
    n = len(size)
    a = size[:, None] * rng.uniform(0.5, 1.0, (n, 2)) * [0.7, 0.4]
    w, phase = 2 * np.pi * rng.uniform(low, high, (n, 2)), rng.uniform(0, 2 * np.pi, (n, 2))

    def motion(t: Array) -> tuple[Array, Array]:
        angle = w * np.asarray(t)[:, None, None] + phase
        return (a * np.sin(angle)).sum(axis=2), (a * w * np.cos(angle)).sum(axis=2)

    return motion
