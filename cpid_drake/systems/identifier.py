"""Identification as a Drake system: from the spacecraft's state, by least squares."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DependencyTicket,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    OutputPort,
    ValueProducer,
)

from cpid_drake.array import Array
from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.gaussian import solution_of_rows
from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.momentum_rows import momentum_columns, momentum_rows
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.identification.arguments import require_spacecraft, resolve_momentum
from cpid_drake.identification.by_rows import LEAST_SQUARES, part_checks
from cpid_drake.identification.consistency import with_nearest_body
from cpid_drake.identification.result import Identification
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.ports import SpacecraftSystem

DIAGNOSTICS = ("samples", "rank", "condition", "residual")
"""Entries of the `diagnostics` output, in order."""


class Identifier(SpacecraftSystem):
    """Base class of the identifiers: it computes the outputs of `MomentumIdentifier` from `_solve`.

    The identification is computed on demand, once for every state.
    """

    @abstractmethod
    def _solve(self, context: Context) -> Identification:
        """Return the identification with its nearest rigid body: a function of the state alone."""

    def identification(self, context: Context) -> Identification:
        """Return the identification of this system's context, with its checks.

        `consistency.checked` finds the part of its intervals that a rigid body can have.
        """
        found: Identification = self._solution.Eval(context)
        return found

    def estimate_ports(self) -> dict[str, OutputPort]:
        """Return the ports that a controller or a visualizer reads, by their names there."""
        names = ("covariance", "spatial_inertia", "checks_passed")
        return {name: self.GetOutputPort(name) for name in names}

    def Finish(self, root_context: Context) -> Identification:
        """Use what is still to be used at the end of a run, and return the identification.

        `MomentumIdentifier` takes the sample that is due now, `SensorIdentifier` solves the block
        that is not complete. The Context is that of the diagram after the run.
        """
        context = self.GetMyMutableContextFromRoot(root_context)
        self.ExecuteForcedEvents(context)
        return self.identification(context)

    def _declare_outputs(self, state_ticket: DependencyTicket) -> None:
        """Declare the ports; `_solve` depends on the state with this ticket."""

        def solve(context: Context, value: AbstractValue) -> None:
            value.set_value(self._solve(context))

        self._solution = self.DeclareCacheEntry(
            "identification",
            ValueProducer(allocate=lambda: AbstractValue.Make(object()), calc=solve),
            prerequisites_of_calc={state_ticket},
        )
        state_only = {self.cache_entry_ticket(self._solution.cache_index())}

        def declare(name: str, size: int, value: Callable[[Identification], ArrayLike]) -> None:
            def calc(context: Context, output: BasicVector) -> None:
                output.SetFromVector(value(self.identification(context)))

            self.DeclareVectorOutputPort(
                name=name, size=size, calc=calc, prerequisites_of_calc=state_only
            )

        def calc_spatial_inertia(context: Context, output: AbstractValue) -> None:
            output.set_value(self.identification(context).spatial_inertia())

        declare("parameters", 10, lambda found: found.parameters)
        declare("covariance", 100, lambda found: found.covariance.ravel())
        self.DeclareAbstractOutputPort(
            name="spatial_inertia",
            alloc=lambda: Value(SpatialInertia.NaN()),
            calc=calc_spatial_inertia,
            prerequisites_of_calc=state_only,
        )
        declare("diagnostics", len(DIAGNOSTICS), _diagnostics)
        declare("checks_passed", 1, lambda found: [bool(found.checks) and found.passed])


def _diagnostics(found: Identification) -> list[float]:
    solution = found.solution
    assert solution is not None
    return [found.sample_count, solution.rank, solution.condition_number, solution.residual_rms]


class MomentumIdentifier(Identifier):
    """Identifies the target's ten inertial parameters online, from momentum conservation.

    In every period it samples the spacecraft's state, computes six momentum rows (those of Ning et
    al. 2016, Eq. 18, are one of the families), and adds them to a square-root information filter,
    which is its discrete state. It contains the *known* spacecraft only.

    .. pydrake_system::

        name: MomentumIdentifier
        input_ports:
        - state
        output_ports:
        - parameters
        - covariance
        - spatial_inertia
        - diagnostics
        - checks_passed

    - `state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state).
    - `parameters` (10): m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg, m, kg·m²] as estimated; see
      `parameterizations.PARAMETER_NAMES`. An entry is NaN until it is identifiable.
    - `covariance` (100): of the parameters, row by row, from the residuals of equally
      weighted rows; NaN until all are identifiable. With standard rows every σ is accurate to a
      factor of about 1.5, or 2 with rounded data. With Eq. 18, whose rows are in m/s and in N·m·s,
      errors are larger, and the σ of the mass can be 25 times too large.
    - `spatial_inertia` (abstract `SpatialInertia`): the physically consistent parameters
      nearest to the estimate, about C's origin, in C; NaN until all are identifiable.
    - `diagnostics` (4): number of samples, rank (10 when all are identifiable), condition number of
      the scaled rows (infinite below rank 10), RMS of the residuals of all rows in their own units
      (Eq. 18: m/s and N·m·s; standard: N·s and N·m·s). See `DIAGNOSTICS`.
    - `checks_passed` (1): 1 if some check was made and none failed, else 0. A rigid body must have
      the estimate within its covariance, and the first quarter to half of the samples must have the
      same target as all of them, if the residuals are more than rounding. What failed is in
      `identification(context)`.

    Args:
        spacecraft: the spacecraft model.
        rows: "standard", "eq18" (the paper's) or "relative"; see
            `cpid_drake.dynamics.rows.ROW_FAMILIES`.
        momentum: the total momentum, zero (default) or unknown; not unknown with "eq18".
        period: time between samples [s]; the paper's is 1 s.
        offset: time of the first sample [s]; the paper's is 1 s, because samples at rest contain no
            information.

    Raises:
        InputError: no such rows, a period that is not positive, or a negative offset; and, when a
            sample is taken, a state that is no motion; see `Motion`.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        rows: str = "standard",
        momentum: TotalMomentum | str | None = None,
        period: float = 1.0,
        offset: float = 1.0,
    ) -> None:
        super().__init__()
        self.set_name("momentum_identifier")
        if not (is_number(period) and period > 0):
            raise InputError(f"identification period must be > 0 s, not {period}")
        if not (is_number(offset) and offset >= 0):
            raise InputError(f"identification offset must be >= 0 s, not {offset}")
        require_spacecraft(spacecraft)
        self._spacecraft = spacecraft
        self._momentum = resolve_momentum(momentum) or TotalMomentum.zero()
        if self._momentum.name == "known":
            raise InputError("identification needs a total momentum that is zero or unknown")
        self._family = row_family(rows, self._momentum.is_unknown)
        self._parameterization = self._family.parameterization(spacecraft.mass)
        self._extra = momentum_columns(spacecraft.tree, self._family, self._momentum)
        self._size = self._extra + 11
        self._tree = spacecraft.tree

        self._state_port = self.DeclareVectorInputPort(
            "state", spacecraft.plant.num_multibody_states()
        )
        self._root_index = self.DeclareDiscreteState(np.zeros(self._size**2))
        # Number of samples, number of rows that are not zero, time of the latest sample.
        self._count_index = self.DeclareDiscreteState([0.0, 0.0, -np.inf])
        # The triangles after the last two numbers of samples that were powers of two.
        self._earlier_index = self.DeclareDiscreteState(np.zeros(2 * self._size**2))
        self._period, self._offset = period, offset
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=period, offset_sec=offset, update=self._take_sample
        )
        self.DeclareForcedDiscreteUpdateEvent(self._take_sample_if_due)
        self._declare_outputs(self.xd_ticket())

    @classmethod
    def AddToBuilder(
        cls,
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        rows: str = "standard",
        momentum: TotalMomentum | str | None = None,
        period: float = 1.0,
        offset: float = 1.0,
    ) -> Self:
        """Add an identifier to a diagram and connect its input; for the options see the class.

        Raises:
            InputError: `state` is not that of this spacecraft.

        """
        identifier = cls(spacecraft, rows=rows, momentum=momentum, period=period, offset=offset)
        return identifier.connected(builder, state=state)

    def _rows(self, context: Context) -> Array:
        """Return the rows [A | b] of this instant; columns of an unknown momentum lead."""
        time, state = context.get_time(), self._state_port.Eval(context)
        with prefix_errors(f"{self.GetSystemPathname()}: the state at t = {time:g} s"):
            motion = self._spacecraft.to_motion(time, state)
            rows = momentum_rows(self._tree, motion, self._family, self._momentum)
            if not np.isfinite(rows).all():
                raise InputError("its momentum is not finite")
        return rows

    def _take_sample(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        samples, row_count, latest = context.get_discrete_state(self._count_index).value()
        if context.get_time() == latest:  # `Finish` took this sample, and the run goes on
            return EventStatus.DidNothing()
        rows = self._rows(context)
        root = updated_information(self._root(context), rows).ravel()
        discrete_state.set_value(self._root_index, root)
        if np.log2(samples + 1) % 1 == 0:
            _, latest_power = np.split(self._earlier(context), 2)
            discrete_state.set_value(self._earlier_index, np.append(latest_power, root))
        # The zero rows of a sample at rest must not be counted: they would reduce the variance.
        row_count += np.count_nonzero(rows.any(axis=1))
        discrete_state.set_value(self._count_index, [samples + 1, row_count, context.get_time()])
        return EventStatus.Succeeded()

    def _take_sample_if_due(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        """Take the sample of this instant, which a simulation leaves pending at its end."""
        periods = (context.get_time() - self._offset) / self._period
        if periods < -1e-9 or abs(periods - round(periods)) > 1e-9:
            return EventStatus.DidNothing()
        return self._take_sample(context, discrete_state)

    def _root(self, context: Context) -> Array:
        root = context.get_discrete_state(self._root_index).value()
        return np.asarray(root.reshape(self._size, self._size))

    def _earlier(self, context: Context) -> Array:
        return np.asarray(context.get_discrete_state(self._earlier_index).value())

    def _solve(self, context: Context) -> Identification:
        samples, row_count, _ = context.get_discrete_state(self._count_index).value()
        first = np.split(self._earlier(context), 2)[0].reshape(self._size, self._size)
        earlier, rows = (
            each[self._extra :, self._extra :] for each in (first, self._root(context))
        )
        solution = solution_of_rows(rows, int(row_count) - self._extra)
        freedom = solution.row_count - solution.rank
        found = Identification.of_solution(
            self._parameterization,
            solution,
            sample_count=int(samples),
            estimator=LEAST_SQUARES,
            rows=self._family.name,
            momentum=self._momentum.name,
            checks=part_checks(earlier, rows, freedom) if solution.rank == 10 else (),
        )
        return with_nearest_body(found, self._tree)


def is_number(value: object) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, (int, float, np.number)) and bool(np.isfinite(value))
