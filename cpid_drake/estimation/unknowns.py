"""The unknowns of a fit: one table of them, with their priors, and the target's coordinates.

Every unknown has a scope: a `log` has its own momentum, forces and biases of gyros, all logs of one
`hardware` share the other errors of its sensors and the spacecraft's bodies, and all logs share the
target. What belongs to a block of time (joint motion, white forces) is in the state of its log; see
`log_state`.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.sensitivity import with_errors
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.gaussian import Gaussian, places_of
from cpid_drake.estimation.likelihood.constants import VALVE_FORCE, Constants
from cpid_drake.estimation.likelihood.forces import white_forces
from cpid_drake.estimation.target import TargetCone
from cpid_drake.sensors.error_kinds import bodies_of, with_plausible
from cpid_drake.sensors.suite import SensorSuite

FASTEST_TUMBLE = 2.0
"""σ of an unknown angular velocity of the system [rad/s]."""

FASTEST_DRIFT = 10.0
"""σ of an unknown velocity of the system's centre of mass [m/s]."""

PSI, BODIES, MOMENTUM = "psi", "bodies", "momentum"
"""Names of the unknowns of the target, of errors of the spacecraft, and of a log's momentum.

Those of the target are ψ = (μ, μ c, I_*) with μ = m_k m / (m_k + m), m_k the nominal mass of the
spacecraft.
"""

_TREES = 4  # spacecraft models with errors that are kept

Scope = Literal["log", "hardware", "target"]


@dataclass(frozen=True, eq=False)
class Unknown:
    """One unknown.

    Attributes:
        name: of the unknown.
        size: number of entries.
        mean: (size,) before the first sample.
        sigma: (size,) σ before the first sample; infinite for the target, whose prior is
            `Model.cone`'s.
        scope: what has it.
        walk: σ of its change after 1 s, as a share of `sigma`; the prior is of the first value.
        may_fail: whether it may be far from its mean, so that its prior has a heavy tail: it weighs
            as a sample that is as far off.
        hardware: see `Model`; empty for what a log has for itself, and for the target.

    """

    name: str
    size: int
    mean: Array
    sigma: Array
    scope: Scope
    walk: float = 0.0
    may_fail: bool = False
    hardware: str = ""

    def key(self, log: str) -> str:
        """Return the name of this unknown of a log, among those of all logs."""
        if self.scope == "log":
            return f"{self.name}|{log}"
        return f"{self.name}@{self.hardware}" if self.hardware else self.name


@dataclass(frozen=True, eq=False)
class Model:
    """The spacecraft model with its sensors, and all unknowns of a fit.

    Attributes:
        tree: the spacecraft model.
        suite: its sensors, with their errors; of several hardwares, those of the first log.
        known_bodies: uncertainty of its bodies; None if they are exact.
        priors: mean and σ of unknowns with another prior than that of `table`.
        rows: further information about unknowns, such as a prior of the target.
        suites: of each log, if not all have the same; one object is one hardware.
        hardware: the first log with this hardware; empty if all logs have it.

    """

    tree: KinematicTree
    suite: SensorSuite
    known_bodies: BodyUncertainty | None = None
    priors: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    rows: tuple[Gaussian, ...] = ()
    suites: Mapping[str, SensorSuite] = field(default_factory=dict)
    hardware: str = ""

    def __post_init__(self) -> None:
        if self.known_bodies is None:
            object.__setattr__(self, "tree", self.tree.lumped)

    @classmethod
    def of(
        cls,
        tree: KinematicTree,
        sensors: SensorSuite | Mapping[str, SensorSuite],
        known_bodies: BodyUncertainty | None = None,
        *,
        has_thrust: bool = False,
    ) -> "Model":
        """Return the model in which all that is not stated has a plausible σ.

        Args:
            tree: the spacecraft model.
            sensors: its sensors, or those of each log; one object is one hardware.
            known_bodies: uncertainty of its bodies as stated; None if it is not.
            has_thrust: whether thrusters fired.

        """
        tree = tree.lumped if known_bodies is None else tree
        suites = sensors if isinstance(sensors, Mapping) else {"": sensors}
        [first, *others] = suites.values()
        if all(suite is first for suite in others):
            suites = {}
        model = cls(tree, first, bodies_of(known_bodies, first, *others), suites=suites)
        return model.with_suites(partial(with_plausible, tree=tree, has_thrust=has_thrust))

    def with_suites(self, change: Callable[[SensorSuite], SensorSuite]) -> "Model":
        """Return the model with changed sensors."""
        made = {id(suite): change(suite) for suite in (self.suite, *self.suites.values())}
        suites = {log: made[id(suite)] for log, suite in self.suites.items()}
        return replace(self, suite=made[id(self.suite)], suites=suites)

    @cached_property
    def _by_log(self) -> dict[str, "Model"]:
        first = {id(suite): log for log, suite in [*self.suites.items()][::-1]}
        made = {
            log: replace(self, suite=self.suites[log], suites={}, hardware=log)
            for log in first.values()
        }
        return {log: made[first[id(suite)]] for log, suite in self.suites.items()}

    def of_log(self, name: str) -> "Model":
        """Return the model with the sensors of a log."""
        return self._by_log[name] if self.suites else self

    def unknowns_of(self, logs: Iterable[str]) -> dict[str, tuple[str, Unknown]]:
        """Return the unknowns of some logs, each with a log that has it, by `Unknown.key`."""
        return {u.key(log): (log, u) for log in logs for u in self.of_log(log).table}

    @cached_property
    def constants(self) -> Constants:
        """The constant errors of the suite."""
        return Constants.of(self.suite, self.joint_count)

    @property
    def mass(self) -> float:
        """Nominal mass of the spacecraft [kg]."""
        return self.tree.at_rest.mass

    @cached_property
    def L_sigma(self) -> float:
        """σ of an unknown angular momentum [N·m·s]."""
        return FASTEST_TUMBLE * float(np.trace(self.tree.at_rest.I_BBcm)) / 3

    @cached_property
    def plausible(self) -> Array:
        """(10,) sizes of ψ of a target as heavy and as large as the spacecraft: (M/2, M r/2, M r²).

        Its inertia about its own centre of mass is not reduced, as its mass is.
        """
        M, moments = self.mass, float(np.trace(self.tree.at_rest.I_BBcm)) / 2
        return np.repeat([M / 2, np.sqrt(M * moments) / 2, moments], [1, 3, 6])

    def sizes(self, psi: Array) -> Array:
        """Return the plausible sizes (10,) of ψ, or those of a target ψ (10,) that is larger."""
        m, moments = max(psi[0], 0.0), max((psi[4] + psi[7] + psi[9]) / 2, 0.0)
        own = np.repeat([m, np.sqrt(m * moments), moments], [1, 3, 6])
        return np.asarray(np.maximum(self.plausible, own))

    @cached_property
    def table(self) -> tuple[Unknown, ...]:
        """The unknowns in the order of columns: constant errors, target, bodies, momentum."""
        table = []
        for error in self.constants.errors.values():
            zero, one = np.zeros(error.size), np.ones(error.size)
            walk = error.walk / error.sigma
            scope: Scope = "hardware" if error.is_shared else "log"
            fails = error.kind == VALVE_FORCE
            owner = self.hardware if error.is_shared else ""
            table.append(Unknown(error.name, error.size, zero, one, scope, walk, fails, owner))
        # A solid sphere about C's origin of a tenth of the spacecraft's mass.
        mean = 0.2 / 1.1 * self.plausible * [1, 0, 0, 0, 0.2, 0, 0, 0.2, 0, 0.2]
        table.append(Unknown(PSI, 10, mean, np.full(10, np.inf), "target"))  # see `cone`
        if self.known_bodies is not None:
            c = self.known_bodies.count(self.tree.wheels, self.joint_count)
            table.append(Unknown(BODIES, c, np.zeros(c), np.ones(c), "hardware"))
        sigma = np.repeat([self.L_sigma, FASTEST_DRIFT], 3)
        table.append(Unknown(MOMENTUM, 6, np.zeros(6), sigma, "log"))
        for k, unknown in enumerate(table):
            mean, sigma = self.priors.get(unknown.name, (unknown.mean, unknown.sigma))
            table[k] = replace(unknown, mean=mean, sigma=sigma)
        return tuple(table)

    @cached_property
    def cone(self) -> TargetCone:
        """The physically consistent targets, and their prior."""
        return TargetCone(self.unknown(PSI).mean, self.mass)

    def with_prior(self, name: str, mean: Array, sigma: Array) -> "Model":
        """Return the model with another prior of one unknown."""
        return replace(self, priors={**self.priors, name: (mean, sigma)})

    def unknown(self, name: str) -> Unknown:
        """Return the unknown of this name."""
        return next(unknown for unknown in self.table if unknown.name == name)

    def force_sizes(self, start: float, end: float) -> dict[str, int]:
        """Return the numbers of entries of white forces, by name, in a block from start to end."""
        is_planar = self.tree.normal_B is not None
        return {f.name: f.size for f in white_forces(self.suite, start, end, is_planar)}

    def no_forces(self, start: float, end: float) -> Array:
        """Return white forces (K,) of zero in a block from start to end [s]."""
        return np.zeros(sum(self.force_sizes(start, end).values()))

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return len(self.tree.jointed)

    @property
    def places(self) -> dict[str, slice]:
        """Columns of the unknowns of one log."""
        return places_of({u.name: u.size for u in self.table})

    @property
    def walking(self) -> list[Unknown]:
        """The unknowns with a random walk."""
        return [u for u in self.table if u.walk]

    @cached_property
    def walking_columns(self) -> NDArray[np.intp]:
        """Columns (w,) of the unknowns with a random walk."""
        columns = [np.r_[self.places[unknown.name]] for unknown in self.walking]
        return np.concatenate([np.empty(0, np.intp), *columns])

    @cached_property
    def walking_sigma(self) -> Array:
        """σ (w,) of their change after 1 s."""
        sigma = [np.full(unknown.size, unknown.walk) for unknown in self.walking]
        return np.concatenate([np.empty(0), *sigma])

    def tree_with(self, errors: Array | None) -> KinematicTree:
        """Return the spacecraft model with errors (c,) of its bodies, in units of σ."""
        if self.known_bodies is None or errors is None or not np.any(errors):
            return self.tree
        key, made = errors.tobytes(), self._trees
        if key not in made:
            made[key] = with_errors(self.tree, self.known_bodies, errors)
            for old in [*made][:-_TREES]:
                del made[old]
        return made[key]

    @cached_property
    def _trees(self) -> dict[bytes, KinematicTree]:
        """The last spacecraft models with errors."""
        return {}

    def start(self, logs: list[str]) -> dict[str, Array]:
        """Return the mean of all unknowns of some logs before the first sample."""
        return {key: u.mean.copy() for key, (_, u) in self.unknowns_of(logs).items()}
