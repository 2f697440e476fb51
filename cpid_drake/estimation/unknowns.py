"""What a fit does not know: one table of unknowns, with their priors, and the target's coordinates.

Every unknown has a scope: a `log` has its own momentum and forces, all logs of one `hardware` share
the errors of its sensors and bodies, and all logs of one `target` share the target. What belongs to
a block of time (joint motion, white forces) is in the state of its log; see `log_state`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import tensor_to_vector
from cpid_drake.dynamics.sensitivity import with_errors
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.gaussian import Gaussian, places_of
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.likelihood.constants import BIAS, OF_GRASP, VALVE_FORCE, Constants
from cpid_drake.estimation.likelihood.forces import white_forces
from cpid_drake.sensors.suite import SensorSuite

WIDE = 1e3
"""σ of a target of which nothing is known, in sizes of a target like the spacecraft."""

FASTEST_TUMBLE = 2.0
"""σ of an unknown angular velocity of the system [rad/s]."""

FASTEST_DRIFT = 10.0
"""σ of an unknown velocity of the system's centre of mass [m/s]."""

LARGEST = 100.0
"""Largest radius of gyration of a target, in radii of gyration of the spacecraft."""

PSI, BODIES, MOMENTUM = "psi", "bodies", "momentum"
"""Names of the target's unknowns, of the known bodies' errors, and of a log's momentum."""

FARTHEST = (0.5, 1.0, 1.0)
"""σ of a change of attitude [rad], of the centre of mass [m] and of its velocity [m/s]."""

Scope = Literal["log", "hardware", "target"]


@dataclass(frozen=True, eq=False)
class Unknown:
    """One unknown.

    Attributes:
        name: of the unknown.
        size: number of entries.
        mean: (size,) before the first sample.
        sigma: (size,) σ before the first sample.
        scope: what has it.
        walk: σ of its change after 1 s, as a share of `sigma`; the prior is of the first value.
        may_fail: whether it may be far from its mean, so that its prior has a heavy tail: it weighs
            as a sample that is as far off.

    """

    name: str
    size: int
    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]
    scope: Scope
    walk: float = 0.0
    may_fail: bool = False

    @property
    def prior(self) -> Gaussian:
        """What is known of it before the first sample."""
        rows = np.column_stack([np.diag(1 / self.sigma), self.mean / self.sigma])
        return Gaussian.of_rows({self.name: self.size}, rows)

    def key(self, log: str) -> str:
        """Return the name of this unknown of a log, among those of all logs."""
        return f"{self.name}|{log}" if self.scope == "log" else self.name


@dataclass(frozen=True, eq=False)
class Model:
    """The known spacecraft with its sensors, and all that a fit does not know about them.

    Attributes:
        tree: the known spacecraft.
        suite: its sensors, with their errors.
        known_bodies: uncertainty of its bodies; None if they are exact.
        priors: mean and σ of unknowns with another prior than that of `table`.
        rows: further information about unknowns, such as a prior of the target.

    """

    tree: KinematicTree
    suite: SensorSuite
    known_bodies: BodyUncertainty | None = None
    priors: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(
        default_factory=dict
    )
    rows: tuple[Gaussian, ...] = ()

    def __post_init__(self) -> None:
        if self.known_bodies is None:
            object.__setattr__(self, "tree", self.tree.lumped)

    @cached_property
    def constants(self) -> Constants:
        """The constant errors of the suite."""
        return Constants.of(self.suite, self.joint_count)

    @property
    def mass(self) -> float:
        """Nominal mass of the known bodies [kg]."""
        return self.tree.at_rest.mass

    @cached_property
    def L_sigma(self) -> float:
        """σ of an unknown angular momentum [N·m·s]."""
        return FASTEST_TUMBLE * float(np.trace(self.tree.at_rest.I_BBcm)) / 3

    @cached_property
    def plausible(self) -> NDArray[np.float64]:
        """(10,) sizes of ψ of a target as heavy and as large as the spacecraft."""
        moments = np.trace(self.tree.at_rest.I_BBcm) / 2
        return _magnitudes(self.mass / 2, np.sqrt(moments / self.mass))

    @cached_property
    def table(self) -> tuple[Unknown, ...]:
        """The unknowns in the order of columns: constant errors, target, bodies, momentum."""
        table = []
        for error in self.constants.errors.values():
            has = (error.sensor and error.kind != BIAS) or error.kind in OF_GRASP
            zero, one = np.zeros(error.size), np.ones(error.size)
            walk = error.walk / error.sigma
            scope: Scope = "hardware" if has else "log"
            fails = error.kind == VALVE_FORCE
            table.append(Unknown(error.name, error.size, zero, one, scope, walk, fails))
        # A solid sphere about C's origin of a tenth of the spacecraft's mass.
        mean = 0.2 / 1.1 * self.plausible * [1, 0, 0, 0, 0.4, 0, 0, 0.4, 0, 0.4]
        table.append(Unknown(PSI, 10, mean, WIDE * self.plausible, "target"))
        if self.known_bodies is not None:
            c = self.known_bodies.count(self.tree.wheels, self.joint_count)
            table.append(Unknown(BODIES, c, np.zeros(c), np.ones(c), "hardware"))
        sigma = np.repeat([self.L_sigma, FASTEST_DRIFT], 3)
        table.append(Unknown(MOMENTUM, 6, np.zeros(6), sigma, "log"))
        for k, unknown in enumerate(table):
            mean, sigma = self.priors.get(unknown.name, (unknown.mean, unknown.sigma))
            table[k] = replace(unknown, mean=mean, sigma=sigma)
        return tuple(table)

    def with_prior(
        self, name: str, mean: NDArray[np.float64], sigma: NDArray[np.float64]
    ) -> "Model":
        """Return the model with another prior of one unknown."""
        return replace(self, priors={**self.priors, name: (mean, sigma)})

    def unknown(self, name: str) -> Unknown:
        """Return the unknown of this name."""
        return next(unknown for unknown in self.table if unknown.name == name)

    @property
    def farthest(self) -> NDArray[np.float64]:
        """σ (12,) of a change of attitude, centre of mass, L and v between two blocks."""
        turn, place, speed = FARTHEST
        return np.repeat([turn, place, self.L_sigma, speed], 3)

    def no_forces(self, start: float, end: float) -> NDArray[np.float64]:
        """Return white forces (K,) of zero in a block from start to end [s]."""
        is_planar = self.tree.normal_B is not None
        forces = white_forces(self.suite, start, end, is_planar)
        return np.zeros(sum(force.size for force in forces))

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return sum(body.joint >= 0 for body in self.tree.bodies)

    @property
    def places(self) -> dict[str, slice]:
        """Columns of the unknowns of one log."""
        return places_of({u.name: u.size for u in self.table})

    @property
    def walking(self) -> list[Unknown]:
        """The unknowns that walk."""
        return [u for u in self.table if u.walk]

    @cached_property
    def walking_columns(self) -> NDArray[np.intp]:
        """Columns (w,) of the unknowns that walk."""
        columns = [np.r_[self.places[unknown.name]] for unknown in self.walking]
        return np.concatenate([np.empty(0, np.intp), *columns])

    @cached_property
    def walking_sigma(self) -> NDArray[np.float64]:
        """σ (w,) of their change after 1 s."""
        sigma = [np.full(unknown.size, unknown.walk) for unknown in self.walking]
        return np.concatenate([np.empty(0), *sigma])

    def tree_with(self, errors: NDArray[np.float64] | None) -> KinematicTree:
        """Return the known spacecraft with errors (c,) of its bodies, in units of σ."""
        if self.known_bodies is None or errors is None or not np.any(errors):
            return self.tree
        return with_errors(self.tree, self.known_bodies, errors)

    def start(self, logs: list[str]) -> dict[str, NDArray[np.float64]]:
        """Return the mean of all unknowns of some logs before the first sample."""
        return {u.key(log): u.mean.copy() for u in self.table for log in logs}


def undetermined(
    model: Model, psi: NDArray[np.float64], gaussian: Gaussian
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the combinations (k, 10) of ψ that are not determined, and plausible sizes (10,).

    The σ of each is more than `KNOWN` of its size. A fit does not move them: they are what a
    target has before the first sample, and no noise makes an impossible body of them.

    Args:
        model: the unknowns.
        psi: (10,) value of the target.
        gaussian: of all unknowns about their values.

    """
    target = gaussian.marginal([PSI])
    psi = psi + target.solve()
    sigma = np.sqrt(np.diag(target.covariance()))
    least = np.sign(psi) * np.maximum(np.abs(psi) - 2 * sigma, 0.0)  # its size as far as known
    sizes = _sizes(least, model.plausible)
    _, s, Vt = np.linalg.svd(target.R * sizes)
    return Vt[s < 1 / KNOWN] / sizes, sizes


def _magnitudes(mass: float, radius: float) -> NDArray[np.float64]:
    """Return (10,) magnitudes of ψ for a reduced mass and a radius of gyration."""
    return mass * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])


def _sizes(psi: NDArray[np.float64], least: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (10,) magnitudes for a target as heavy and large as one with ψ, but not below some."""
    if not psi[0] > 0:
        return least
    moments = psi[[4, 7, 9]]
    spread = max(float(moments.sum()) / 2, float(moments.max()), 0.0)  # Σ m r²: some may be unknown
    radius = min(np.sqrt(spread / psi[0]), LARGEST * np.sqrt(least[4] / least[0]))
    return np.maximum(_magnitudes(psi[0], radius), least)


def psi_about(
    x: NDArray[np.float64], nominal_mass: float, mass: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ψ (10,) about known bodies of another mass, and its derivative (10, 10) by x.

    The coordinates x of a target are ψ about the *nominal* mass of the known bodies, a fixed
    function of the target's (m, m c, J). With f = m_k/(m_k + m) and P(h) = |h|²1 − hhᵀ,

        ψ = (m f, f h, J − P(h)/(m_k + m)),

    and the same with the nominal mass for x. Nothing is singular at m = 0. Source: design, 3.2.

    Args:
        x: (10,) the target's coordinates.
        nominal_mass, mass: of the known bodies, nominal and with their present errors [kg].

    """
    if mass == nominal_mass:
        return x, np.eye(10)
    up = nominal_mass / (nominal_mass - x[0])  # 1 + m / nominal_mass
    m, h = up * x[0], up * x[1:4]
    phi = np.concatenate([[m], h, x[4:] + _shift(h, h) / (nominal_mass + m)])
    (_, x_phi), (psi, psi_phi) = (_psi_of(phi, each) for each in (nominal_mass, mass))
    return psi, np.asarray(np.linalg.solve(x_phi.T, psi_phi.T).T)


def _psi_of(
    phi: NDArray[np.float64], mass: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ψ (10,) of φ = (m, m c, J) about known bodies of a mass, and its derivative."""
    h, total = phi[1:4], mass + phi[0]
    f, by = mass / total, np.eye(10)
    by[0, 0], by[1:4, 0], by[1:4, 1:4] = f**2, -f / total * h, f * np.eye(3)
    by[4:, 0] = _shift(h, h) / total**2
    by[4:, 1:4] = -2 / total * np.column_stack([_shift(h, e) for e in np.eye(3)])
    return np.concatenate([f * phi[:4], phi[4:] - _shift(h, h) / total]), by


def _shift(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric bilinear form of P(h) = |h|²1 − hhᵀ, as a vector (6,)."""
    return np.asarray(tensor_to_vector((a @ b) * np.eye(3) - (np.outer(a, b) + np.outer(b, a)) / 2))
