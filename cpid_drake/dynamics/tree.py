"""The spacecraft's bodies as a tree of joints, in plain NumPy."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import point_mass_inertia, vector_to_tensor
from cpid_drake.dynamics.plane import ALONG, parallel_axis


@dataclass(frozen=True, kw_only=True)
class TreeBody:
    """One body k of the tree and the joint that connects it to its inboard body.

    The body's frame B is the joint's outboard frame, so at q = 0 it is the inboard frame F.

    Attributes:
        name: the body's name.
        parent: index of the inboard body in the tree; −1 for the base.
        joint: column of the joint in q, or −1 where the body is welded.
        multiplier: of that column; the joint's position is their product.
        follows: whether the joint follows another one, which has the column.
        joint_name: the joint's own name; empty for a weld.
        prismatic: whether the joint slides along its axis (else it rotates about it).
        axis_F: (3,) unit vector of the joint's axis, the same in F and in B; zero for a weld.
        R_PF, p_PF: pose of F, fixed on the inboard body P.
        mass: [kg].
        p_BBcm: (3,) centre of mass in the body's frame [m].
        I_BBcm: (3, 3) inertia about the centre of mass in the body's frame [kg·m²].

    """

    name: str
    parent: int = -1
    joint: int = -1
    multiplier: float = 1.0
    follows: bool = False
    joint_name: str = ""
    prismatic: bool = False
    axis_F: Array = field(default_factory=lambda: np.zeros(3))
    R_PF: Array = field(default_factory=lambda: np.eye(3))
    p_PF: Array = field(default_factory=lambda: np.zeros(3))
    mass: float
    p_BBcm: Array
    I_BBcm: Array


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """The spacecraft's bodies, inboard before outboard, and the capture frame C on one of them.

    Attributes:
        bodies: the spacecraft's bodies.
        capture_body: the body that C is fixed on.
        R_BC, p_BC: pose of C in this body's frame.
        normal_B: (3,) unit normal, in the base's frame, of a table that carries the base, which
            then moves in a plane; None for a base that floats freely. See `dynamics.plane`.

    """

    bodies: tuple[TreeBody, ...]
    capture_body: int
    R_BC: Array
    p_BC: Array
    normal_B: Array | None = None

    @property
    def mass(self) -> float:
        """Total mass of the bodies [kg]."""
        return float(sum(body.mass for body in self.bodies))

    @property
    def masses(self) -> Array:
        """(K, 1) masses of the bodies [kg]."""
        return np.array([[body.mass] for body in self.bodies])

    @property
    def inertias(self) -> Array:
        """(K, 1, 3, 3) inertias of the bodies about their centres of mass, in B [kg·m²]."""
        return np.stack([body.I_BBcm for body in self.bodies])[:, None]

    @property
    def jointed(self) -> list[int]:
        """Indices of the bodies whose joints move and do not follow others."""
        return [k for k, body in enumerate(self.bodies) if body.joint >= 0 and not body.follows]

    @property
    def sliding(self) -> set[int]:
        """Columns of q of the joints that slide."""
        return {self.bodies[k].joint for k in self.jointed if self.bodies[k].prismatic}

    @cached_property
    def lumped(self) -> "KinematicTree":
        """The same tree with welded bodies joined into one: the same momentum with less work."""
        lumps: list[TreeBody] = []
        # The lump of each body, and its pose.
        where: list[tuple[int, Array, Array]] = []
        for body in self.bodies:
            lump, R_LP, p_LP = where[body.parent] if body.parent >= 0 else (-1, np.eye(3), 0.0)
            R_LF, p_LF = R_LP @ body.R_PF, p_LP + R_LP @ body.p_PF
            if body.joint < 0 <= lump:
                where.append((lump, R_LF, p_LF))
                lumps[lump] = _merged(lumps[lump], body, R_LF, p_LF)
            else:
                where.append((len(lumps), np.eye(3), np.zeros(3)))
                lumps.append(replace(body, parent=lump, R_PF=R_LF, p_PF=p_LF))
        lump, R_LB, p_LB = where[self.capture_body]
        R_BC, p_BC = R_LB @ self.R_BC, p_LB + R_LB @ self.p_BC
        return replace(self, bodies=tuple(lumps), capture_body=lump, R_BC=R_BC, p_BC=p_BC)

    @cached_property
    def at_rest(self) -> TreeBody:
        """All bodies as one, with the joints at zero."""
        welded = tuple(replace(body, joint=-1) for body in self.bodies)
        return replace(self, bodies=welded).lumped.bodies[0]

    @cached_property
    def normal_C(self) -> Array | None:
        """(3,) the table's normal in C; None without a table, or if joints rotate C out of it."""
        if self.normal_B is None:
            return None
        chain, k = [], self.capture_body
        while k > 0:
            chain.append(self.bodies[k])
            k = self.bodies[k].parent
        normal = self.normal_B
        for body in reversed(chain):
            normal = body.R_PF.T @ normal
            turns = body.joint >= 0 and not body.prismatic
            if turns and np.linalg.norm(np.cross(body.axis_F, normal)) > ALONG:
                return None
        return np.asarray(self.R_BC.T @ normal)

    @property
    def plane_axis(self) -> int:
        """Number of C's axis that is always the table's normal; −1 if there is none."""
        return -1 if self.normal_C is None else parallel_axis(self.normal_C)

    @property
    def unknowns(self) -> NDArray[np.intp]:
        """Places of the target's unknowns on which the motion depends: all ten, or four.

        On a table they are m, the components of m c across the normal, and nᵀ J n.
        """
        axis = self.plane_axis
        across = np.delete([1, 2, 3], max(axis, 0))
        return np.arange(10) if axis < 0 else np.array([0, *across, (4, 7, 9)[axis]])

    def with_target(self, phi: Array) -> "KinematicTree":
        """Return the tree with a target of standard vector φ (10,) welded on C, as its last body.

        The target's mass must not be zero.
        """
        mass, com = phi[0], phi[1:4] / phi[0]
        target = TreeBody(
            name="target",
            parent=self.capture_body,
            R_PF=self.R_BC,
            p_PF=self.p_BC,
            mass=mass,
            p_BBcm=com,
            I_BBcm=vector_to_tensor(phi[4:]) - point_mass_inertia(mass, com),
        )
        return replace(self, bodies=(*self.bodies, target))

    @property
    def carrying(self) -> set[int]:
        """Columns of q of the joints between the base and C, and of those that move with them."""
        bodies, k = set[int](), self.capture_body
        while k >= 0:
            bodies.add(self.bodies[k].joint)
            k = self.bodies[k].parent
        return bodies - {-1}

    def is_rotor(self, joint: int) -> bool:
        """Return whether a joint's angle has no effect, as for a reaction wheel.

        Such a joint rotates a single body, and no other body is attached to that body. Its centre
        of mass is on the axis, and its inertia is symmetric about the axis (to 1e-6 of its size).
        The same holds for all joints that follow it.
        """
        return all(self._is_balanced(k) for k, b in enumerate(self.bodies) if b.joint == joint)

    def _is_balanced(self, k: int) -> bool:
        """Return whether the rotation of body k alone has no effect."""
        body, axis = self.bodies[k], self.bodies[k].axis_F
        if body.prismatic or k == self.capture_body or any(b.parent == k for b in self.bodies):
            return False
        off_axis = body.p_BBcm - axis * (axis @ body.p_BBcm)
        about, size = axis @ body.I_BBcm @ axis, np.trace(body.I_BBcm)
        along = np.outer(axis, axis)
        balanced = about * along + (size - about) / 2 * (np.eye(3) - along)
        return bool(
            body.mass * off_axis @ off_axis <= 1e-6 * size
            and np.abs(body.I_BBcm - balanced).max() <= 1e-6 * size
        )

    @cached_property
    def wheels(self) -> tuple[bool, ...]:
        """For each body, whether it is a wheel of the base: a rotor that no other joint carries.

        The last link of an arm may be a rotor by its drawing, too, but is no wheel.
        """
        on_base = [True]
        for body in self.bodies[1:]:
            on_base.append(on_base[body.parent] and body.joint < 0)
        return tuple(
            body.joint >= 0 and on_base[body.parent] and self.is_rotor(body.joint)
            for body in self.bodies
        )


def _merged(lump: TreeBody, body: TreeBody, R_LB: Array, p_LB: Array) -> TreeBody:
    """Return a lump after the addition of one body that is fixed in the lump's frame L."""
    mass = lump.mass + body.mass
    if not body.mass > 0:
        return lump
    coms = np.stack([lump.p_BBcm, p_LB + R_LB @ body.p_BBcm])
    com = np.array([lump.mass, body.mass]) @ coms / mass
    inertia = lump.I_BBcm + R_LB @ body.I_BBcm @ R_LB.T
    for part, place in zip((lump.mass, body.mass), coms):
        inertia = inertia + point_mass_inertia(part, place - com)
    return replace(lump, mass=mass, p_BBcm=com, I_BBcm=inertia)
