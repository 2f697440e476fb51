"""Row families: momentum conservation as equations that are linear in the target's ten unknowns.

Each family turns momentum samples into rows A θ = b, for batch and for online identification. All
assume a rigid grasp (ω_n = ω_C) and no external force, and a total momentum that is zero, or
constant and unknown where its columns are added.

Corrections of the paper (Ning et al. 2016) that these rows contain:

- the sums of Eqs. 10, 14 and 18 start at the base, i = 0;
- the right-hand side of Eq. 14 contains v_C, the velocity of the last *known* link at the capture
  point (subscript n_i as in Eqs. 7 and 18), not the velocity of the target's centre of mass;
- d_no is the capture point, and L is the angular momentum about that point;
- in Eqs. 7, 10 and 14, c and I are expressed in W and change as the target rotates, so these
  equations can be solved at one instant only (they are in tests/paper_equations.py). In Eq. 18, c
  and I are expressed in C and are constant, so its rows can be stacked over time;
- two samples never suffice: they give rank 9 of 10. With n = ω1 × ω2 in C, I = n nᵀ satisfies
  I ω1 = I ω2 = 0. Three generic samples give rank 10.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.momentum import MomentumSamples
from cpid_drake.dynamics.parameterizations import (
    EQ18,
    STANDARD,
    Parameterization,
    relative_parameterization,
    vector_to_tensor,
)
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.files.errors import InputError

# Row k is [#e_k], flattened: column j of it is E_j e_k with E_j the tensor of unit vector j.
_INERTIA_OPERATOR = vector_to_tensor(np.eye(6)).transpose(2, 1, 0).reshape(3, 18)


def inertia_operator(v: ArrayLike) -> Array:
    """Return [#v] (..., 3, 6) with I v = [#v] (I11, I12, I13, I22, I23, I33).

    Source: Ning et al. 2016, Eq. 11.
    """
    v = np.asarray(v)
    return (v @ _INERTIA_OPERATOR).reshape(*v.shape, 6)


def _eq18(v: Array, w: Array, P: Array, L: Array) -> Array:
    """[P  ω̃  0 | −v ; 0  P̃  [#ω] | −L] (6, 11), all in C (Ning et al. 2016, Eq. 18)."""
    rows = np.zeros((6, 11))
    rows[:3, 0], rows[:3, 1:4], rows[:3, 10] = P, skew(w), -v
    rows[3:, 1:4], rows[3:, 4:10], rows[3:, 10] = skew(P), inertia_operator(w), -L
    return rows


def _standard(v: Array, w: Array, P: Array, L: Array) -> Array:
    """[v  ω̃  0 | −P ; 0  −ṽ  [#ω] | −L] (6, 11), all in C: the target's own momentum."""
    rows = np.zeros((6, 11))
    rows[:3, 0], rows[:3, 1:4], rows[:3, 10] = v, skew(w), -P
    rows[3:, 1:4], rows[3:, 4:10], rows[3:, 10] = -skew(v), inertia_operator(w), -L
    return rows


def _at_all_samples(block: Callable[..., Array]) -> Callable[[MomentumSamples], Array]:
    """Return the rows of N samples from those of one, which are linear in (v, ω, P, L)."""
    # One product with the rows at unit vectors: a third of the time of entry by entry.
    at_units = np.stack([block(*unit).ravel() for unit in np.eye(12).reshape(12, 4, 3)])
    return lambda samples: (samples.in_C.reshape(-1, 12) @ at_units).reshape(-1, 11)


def relative_regressor(s: ArrayLike, sdot: ArrayLike, w: ArrayLike) -> Array:
    """Return Y (..., 3, 10) with Y (μ, μc, I_*) the target's part of the angular momentum.

    Y = [s×ṡ  s̃ω̃ − ṡ̃  [#ω]], about the system's centre of mass.

    Args:
        s: (..., 3) vector from the spacecraft's centre of mass to C's origin, in C [m].
        sdot: (..., 3) its rate in W, expressed in C [m/s].
        w: (..., 3) angular velocity of C in W, in C [rad/s].

    """
    s = skew(s)
    first = s @ np.asarray(sdot)[..., None]
    return np.concatenate([first, s @ skew(w) - skew(sdot), inertia_operator(w)], axis=-1)


def _relative(samples: MomentumSamples) -> Array:
    """[Y | −L_K] (3 N, 11), all in C: L_K + μ s × ṡ + μ (s × (ω × c) + c × ṡ) + I_* ω = 0.

    L_K is the spacecraft's angular momentum about its own centre of mass, and s = p_C − r_k.
    """
    v, w, P, L = np.swapaxes(samples.in_C, 0, 1)
    s = rotate(np.swapaxes(samples.motion.R_WC, -1, -2), samples.motion.p_WC - samples.p_WKcm)
    L_K = L + cross(s, P)
    rows = [relative_regressor(s, v - P / samples.mass, w), -L_K[:, :, None]]
    return np.concatenate(rows, axis=2).reshape(-1, 11)


def conserved(samples: MomentumSamples) -> Array:
    """Return rows [A | b] (3, N, 3, 11) in W of what is conserved without external forces.

    With ψ = (μ, μc, I_*), A ψ − b is

    - the angular momentum about the system's centre of mass [N·m·s],
    - the velocity of this centre [m/s], and
    - its place [m], which moves at this velocity.
    """
    C, m = samples.motion, samples.mass
    rows = np.zeros((3, len(samples), 3, 11))
    # L = L_K + Y ψ, the relative rows
    rows[0] = C.R_WC @ _relative(samples).reshape(-1, 3, 11)
    # v = v_K + (μ (v_C − v_K) + ω × μc) / m_k
    v_K = samples.P / m
    rows[1, :, :, 0] = (C.v_WC - v_K) / m
    rows[1, :, :, 1:4] = skew(C.w_WC) @ C.R_WC / m
    rows[1, :, :, 10] = -v_K
    # p = p_K + (μ (p_C − p_K) + μc) / m_k
    rows[2, :, :, 0] = (C.p_WC - samples.p_WKcm) / m
    rows[2, :, :, 1:4] = C.R_WC / m
    rows[2, :, :, 10] = -samples.p_WKcm
    return rows


def _momentum_columns(samples: MomentumSamples) -> Array:
    """Columns (6 N, 6) of −[R_WCᵀ P0; R_WCᵀ (L0 − p_WC × P0)] in an unknown momentum [L0; P0]."""
    R_CW = np.swapaxes(samples.motion.R_WC, -1, -2)
    columns = np.zeros((len(samples), 6, 6))
    columns[:, :3, 3:] = columns[:, 3:, :3] = -R_CW
    columns[:, 3:, 3:] = R_CW @ skew(samples.motion.p_WC)
    return columns.reshape(-1, 6)


@dataclass(frozen=True)
class RowFamily:
    """One form of momentum conservation as rows, and the unknowns in which the rows are linear.

    Attributes:
        name: the name in scenarios and on the command line.
        parameterization: the unknowns of the ten columns, as a function of the spacecraft's mass
            [kg].
        augmented_rows: [A | b] stacked over the samples, (rows_per_sample · N, 11), in C.
        momentum_columns: columns (rows_per_sample · N, momentum_size) of a constant total momentum
            that is unknown; None where the rows are not linear in it.
        rows_per_sample: 6, or 3 where only angular momentum is used.
        uses_base_position: whether the rows depend on the base's position and velocity.
        linear_unit: unit of the linear rows, those before the last three of a sample.
        good_for: its recommended use, in a few words.

    """

    name: str
    parameterization: Callable[[float], Parameterization]
    augmented_rows: Callable[[MomentumSamples], Array]
    momentum_columns: Callable[[MomentumSamples], Array] | None = None
    rows_per_sample: int = 6
    uses_base_position: bool = True
    linear_unit: str = "N·s"
    good_for: str = ""

    @property
    def momentum_size(self) -> int:
        """Number of unknowns that a constant total momentum adds; 0 without its columns."""
        return 0 if self.momentum_columns is None else self.rows_per_sample

    def rows(self, samples: MomentumSamples) -> tuple[Array, Array]:
        """Return A (N, rows_per_sample, 10) and b (N, rows_per_sample), expressed in C."""
        augmented = self.augmented_rows(samples).reshape(-1, self.rows_per_sample, 11)
        return augmented[..., :10], augmented[..., 10]

    def full_rows(self, samples: MomentumSamples, unknown_momentum: bool) -> Array:
        """Return [A | b] (R, 11), or [N | A | b] with the columns N of an unknown momentum."""
        rows = self.augmented_rows(samples)
        if not unknown_momentum:
            return rows
        assert self.momentum_columns is not None  # see `row_family`
        return np.hstack([self.momentum_columns(samples), rows])

    def momenta_in_plane(self) -> NDArray[np.intp]:
        """Return the places of the unknowns of a constant momentum that count on a table."""
        return np.array([2, 3, 4][: self.momentum_size // 2] or [], dtype=np.intp)

    def rows_in_plane(self, rows: Array, R_WC: Array, unknowns: NDArray[np.intp]) -> Array:
        """Return the rows (3 N, l + 11) of P_x, P_y and L_z in W from those of `full_rows` in C.

        They are (N, l + 11) without linear rows, with the l columns of `momenta_in_plane`.

        Args:
            rows: (rows_per_sample · N, k + 11).
            R_WC: (N, 3, 3) attitude of C.
            unknowns: places (u,) of the target's unknowns that act, see `KinematicTree.unknowns`;
                columns of others become zero.

        """
        k = rows.shape[1] - 11
        by_sample = rows.reshape(len(R_WC), -1, 3, rows.shape[1])
        in_W = (R_WC[:, None] @ by_sample).reshape(len(R_WC), -1, rows.shape[1])
        in_W[..., k + np.delete(np.arange(10), unknowns)] = 0.0
        momenta = self.momenta_in_plane() if k else np.empty(0, dtype=np.intp)
        columns = np.append(momenta, np.arange(k, k + 11))
        conserved = [0, 1, 5] if self.rows_per_sample == 6 else [2]
        return in_W[:, conserved][:, :, columns].reshape(-1, len(columns))


EQ18_ROWS = RowFamily(
    "eq18",
    lambda known_mass: EQ18,
    _at_all_samples(_eq18),
    linear_unit="m/s",
    good_for="the paper's own equations, for exact logs without momentum",
)
"""Ning et al. 2016, Eq. 18, in θ = (1/m, c, [I#]); its top rows are rotated from W to C."""

STANDARD_ROWS = RowFamily(
    "standard",
    lambda known_mass: STANDARD,
    _at_all_samples(_standard),
    _momentum_columns,
    good_for="logs of the base's attitude and position",
)
"""The same physics in φ = (m, m c, J): the measured momentum is on the right-hand side only."""

RELATIVE_ROWS = RowFamily(
    "relative",
    relative_parameterization,
    _relative,
    lambda samples: -np.swapaxes(samples.motion.R_WC, -1, -2).reshape(-1, 3),  # in W
    rows_per_sample=3,
    uses_base_position=False,
    good_for="logs without the base's position, or with an unknown linear momentum",
)
"""Rows in ψ = (μ, μc, I_*), from attitude and joints only: no base position, no linear momentum."""

ROW_FAMILIES = {family.name: family for family in (EQ18_ROWS, STANDARD_ROWS, RELATIVE_ROWS)}
"""The row families by name. A family added here can be used wherever rows are named."""


def row_family(name: str, unknown_momentum: bool = False) -> RowFamily:
    """Return the row family of this name.

    Raises:
        InputError: no row family has this name, or its rows are not linear in an unknown momentum
            that is to be estimated.

    """
    if name not in ROW_FAMILIES:
        raise InputError(f"no row family '{name}'; choose from {', '.join(ROW_FAMILIES)}")
    family = ROW_FAMILIES[name]
    if unknown_momentum and family.momentum_columns is None:
        others = ", ".join(n for n, other in ROW_FAMILIES.items() if other.momentum_columns)
        raise InputError(f"rows '{name}' cannot estimate an unknown momentum; use {others}")
    return family
