"""Small rigid displacements of a joint with all bodies outboard of it, and their momentum.

S = [a; o × a] is a small screw, I and Π are the spatial inertia and the momentum about B's origin,
in B, of the displaced bodies, and V is the twist of the body inboard of them, which keeps its
motion. The momentum of the displaced bodies changes by

    dΠ = S ×* Π − I (S × V),

with × and ×* the cross products of twists and of momenta. Source: Featherstone 2008, ch. 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.kinematics import BodyMotion, forward_kinematics
from cpid_drake.dynamics.momentum import momenta
from cpid_drake.dynamics.parameterizations import moved_moments
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.dynamics.tree import KinematicTree


@dataclass(frozen=True, eq=False)
class Outboard:
    """All bodies outboard of each of K bodies, itself included, at N instants seen from the base.

    Attributes:
        tree: the tree.
        bodies: motion of each body alone.
        V: (K, N, 6) twist of each body alone at B's origin, in B.
        momentum: (K, N, 6) momentum [L; P] about B's origin, in B.

    """

    tree: KinematicTree
    bodies: BodyMotion
    V: Array
    momentum: Array

    @classmethod
    def at(
        cls,
        tree: KinematicTree,
        q: ArrayLike,
        qdot: ArrayLike,
        w_WB: ArrayLike = 0.0,
        v_WB: ArrayLike = 0.0,
    ) -> "Outboard":
        """Return it at joint positions and rates (N, J) and velocities of the base (N, 3), in B."""
        bodies, _ = forward_kinematics(tree, q, qdot, w_WB=w_WB, v_WB=v_WB)
        V = np.concatenate([bodies.w, bodies.v - cross(bodies.w, bodies.r)], axis=-1)
        P, L = momenta(tree, bodies)
        return cls(tree, bodies, V, _summed(tree, np.concatenate([L, P], axis=-1)))

    @cached_property
    def _inertia(self) -> tuple[Array, Array, Array]:
        """Mass (K, 1, 1), first moment (K, N, 3) and inertia (K, N, 3, 3) about B's origin."""
        tree, bodies = self.tree, self.bodies
        each = moved_moments(tree.masses, tree.inertias, bodies.R, bodies.r)
        moment, inertia = (_summed(tree, one) for one in each)
        return _summed(tree, tree.masses[..., None]), moment, inertia

    @property
    def inboard_of_target(self) -> list[int]:
        """Indices of the bodies from the target, the last body of the tree, to the base."""
        return self._inboard_of(len(self.tree.bodies) - 1)

    def _inboard_of(self, k: int) -> list[int]:
        chain = [k]
        while chain[-1] > 0:
            chain.append(self.tree.bodies[chain[-1]].parent)
        return chain

    def momentum_by(self, which: Sequence[int], V: Array) -> Array:
        """Return the momentum I V (n, N, 6) of bodies `which` (n,) and all outboard of them.

        V (n, N, 6) are twists at B's origin, in B.
        """
        mass, h, inertia = (part[list(which)] for part in self._inertia)
        w, v = V[..., :3], V[..., 3:]
        return np.concatenate([rotate(inertia, w) + cross(h, v), mass * v - cross(h, w)], axis=-1)

    def displaced(self, which: Sequence[int], S: Array) -> tuple[Array, Array]:
        """Return S ×* Π − I (S × V) and I S, (N, 6, n) each.

        Args:
            which: (n,) indices of the bodies that each of n small screws displaces, together with
                all bodies outboard of it. The body inboard of it keeps its motion.
            S: (N, 6, n) the screws at B's origin, in B.

        """
        S = np.moveaxis(S, -1, 0)
        inboard = self.V[[self.tree.bodies[k].parent for k in which]]
        change = cross_force(S, self.momentum[list(which)])
        change -= self.momentum_by(which, cross_motion(S, inboard))
        return np.moveaxis(change, 0, -1), np.moveaxis(self.momentum_by(which, S), 0, -1)

    def by_screws(self, which: Sequence[int], S: Array) -> Array:
        """Return the momentum I S (N, 6, n) of bodies that move along screws; see `displaced`."""
        return np.moveaxis(self.momentum_by(which, np.moveaxis(S, -1, 0)), 0, -1)

    def inertia_along(self, which: Sequence[int], S: Array) -> Array:
        """Return Sᵢᵀ I Sⱼ (N, n, n) with the inertia I of all bodies that both screws displace.

        The arguments are those of `displaced`.
        """
        each = np.swapaxes(self.by_screws(which, S), 1, 2) @ S
        is_inboard = np.array([np.isin(which, self._inboard_of(k)) for k in which])
        other = np.where(is_inboard.T, np.swapaxes(each, 1, 2), 0.0)
        return np.where(is_inboard, each, other)

    def joint_screw(self, k: int) -> Array:
        """Return the twist (N, 6) of the joint of body k at unit rate of its coordinate."""
        body, R, r = self.tree.bodies[k], self.bodies.R[k], self.bodies.r[k]
        axis = rotate(R, body.multiplier * body.axis_F)
        if body.prismatic:
            return np.concatenate([np.zeros_like(axis), axis], axis=-1)
        return np.concatenate([axis, cross(r - rotate(R, body.p_BBcm), axis)], axis=-1)

    def efforts(self, rate: Array) -> Array:
        """Return the efforts (N, J) of the joints for momenta of this rate (K, N, 6), seen from B.

        The force on all bodies outboard of a joint comes through the joint and is the rate of their
        momentum: τ = Sᵀ (dΠ/dt + V ×* Π) with the twist V of the base.
        """
        return self.by_joint(self.loads(*self.joint_screws, rate))

    def loads(self, which: Sequence[int], S: Array, rate: Array) -> Array:
        """Return the loads (N, n) along screws of bodies; see `displaced` and `efforts`."""
        force = rate + cross_force(self.V[0], self.momentum)
        return np.asarray(np.einsum("nsk,kns->nk", S, force[list(which)]))

    @cached_property
    def joint_screws(self) -> tuple[list[int], Array]:
        """The n bodies that joints move, by their columns of q, and the joints' screws (N, 6, n).

        Of joints that follow others, n is larger than J; see `by_joint`.
        """
        bodies = self.tree.bodies
        moving = [k for k, body in enumerate(bodies) if body.joint >= 0]
        moving.sort(key=lambda k: (bodies[k].joint, bodies[k].follows))
        screws = [self.joint_screw(k) for k in moving]
        return moving, np.stack(screws, -1) if screws else np.zeros((len(self.bodies.r[0]), 6, 0))

    def by_joint(self, values: Array) -> Array:
        """Return values (..., n + m) of `joint_screws`, and of m others, by joint (..., J + m).

        A coordinate moves with all its joints: derivatives by it are sums, and so is its effort.
        """
        columns = [self.tree.bodies[k].joint for k in self.joint_screws[0]]
        firsts = np.flatnonzero(np.diff(columns, prepend=-1))
        if len(firsts) == len(columns):
            return values
        own = np.add.reduceat(values[..., : len(columns)], firsts, axis=-1)
        return np.concatenate([own, values[..., len(columns) :]], axis=-1)

    @cached_property
    def grasp_screws(self) -> tuple[list[int], Array]:
        """The target for each of the screws (N, 6, 6): turns about C's axes, shifts along them."""
        last = len(self.tree.bodies) - 1
        shifts, turns = np.split(self.frame_screws(last, np.eye(3)), 2, axis=-1)
        return 6 * [last], np.concatenate([turns, shifts @ self.tree.bodies[last].R_PF], axis=-1)

    def frame_screws(self, k: int, turns_F: Array) -> Array:
        """Return the screws (N, 6, 3 + n) of the inboard frame F of body k's joint.

        They are translations along the axes of its inboard body P, and rotations about F's origin.

        Args:
            k: the body.
            turns_F: (3, n) axes of the turns, in F.

        """
        body = self.tree.bodies[k]
        R_P, p_PBcm = self.bodies.R[body.parent], self.tree.bodies[body.parent].p_BBcm
        axes = R_P @ body.R_PF @ turns_F
        origin = self.bodies.r[body.parent] + rotate(R_P, body.p_PF - p_PBcm)
        turns = np.concatenate([axes, skew(origin) @ axes], axis=1)
        return np.concatenate([np.concatenate([np.zeros_like(R_P), R_P], axis=1), turns], axis=-1)


def _summed(tree: KinematicTree, each: Array) -> Array:
    """Return sums over all bodies outboard of each, from values of each body alone (K, ...)."""
    result = each.copy()
    for k in range(len(tree.bodies) - 1, 0, -1):  # outboard bodies first
        result[tree.bodies[k].parent] += result[k]
    return result


def cross_motion(S: Array, V: Array) -> Array:
    """Return S × V of twists [ω; v] (N, 6)."""
    w, v = S[..., :3], S[..., 3:]
    return np.concatenate(
        [cross(w, V[..., :3]), cross(v, V[..., :3]) + cross(w, V[..., 3:])], axis=-1
    )


def cross_force(S: Array, F: Array) -> Array:
    """Return S ×* F of a twist [ω; v] and a momentum [L; P] (N, 6)."""
    w, v = S[..., :3], S[..., 3:]
    return np.concatenate(
        [cross(w, F[..., :3]) + cross(v, F[..., 3:]), cross(w, F[..., 3:])], axis=-1
    )
