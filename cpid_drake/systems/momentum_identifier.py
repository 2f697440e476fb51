"""Identification as a Drake system: from the spacecraft's state, by least squares."""

from math import isfinite
from typing import TYPE_CHECKING, Self

import numpy as np
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    OutputPort,
)

from cpid_drake.array import Array
from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.gaussian import LeastSquaresSolution, solution_of_triangle
from cpid_drake.estimation.least_squares import quantile_95, updated_information
from cpid_drake.estimation.momentum_rows import momentum_columns, rows_of_samples
from cpid_drake.estimation.parameters import determined_parameters
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.spacecraft.spacecraft_argument import require_spacecraft
from cpid_drake.systems.identifier import Estimate, Identifier, is_number
from cpid_drake.systems.plant_state import require_conservation, spacecraft_state

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification


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

    - `state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state). A state of
      zeros, as of a hold before its first value, is no sample.
    - `parameters` (10): m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg, m, kg·m²] as estimated; see
      `parameterizations.PARAMETER_NAMES`. An entry is NaN until it is identifiable.
    - `covariance` (100): of the parameters, row by row, from the residuals of equally
      weighted rows; NaN until all are identifiable. Residuals that integration leaves are no noise,
      and count in full; see `least_squares.residual_variance`. With Eq. 18, whose rows are in m/s
      and in N·m·s, the σ of the mass can be 25 times too large.
    - `spatial_inertia` (abstract `SpatialInertia`): the physically consistent parameters
      nearest to the estimate, about C's origin, in C; NaN until all are identifiable.
    - `diagnostics` (4): number of samples, rank (10 when all are identifiable), condition number of
      the scaled rows (infinite below rank 10), RMS of the residuals of all rows in their own units
      (Eq. 18: m/s and N·m·s; standard: N·s and N·m·s). See `DIAGNOSTICS`.
    - `checks_passed` (1): 1 if the conservation of momentum was checked, for which the rows need
      twice as many as there are unknowns (four samples), and no check failed. The checks: momentum
      is conserved to 1e-5 of the spacecraft's; a rigid body has the estimate within its covariance;
      the first quarter to half of the samples has the same target as all of them. What failed is in
      `identification(context)`.

    Args:
        spacecraft: the spacecraft model.
        rows: "standard", "eq18" (the paper's) or "relative"; see
            `cpid_drake.dynamics.rows.ROW_FAMILIES`.
        momentum: the total momentum, zero (default) or unknown; not unknown with "eq18".
        period: time between samples [s]; the paper's is 1 s.
        offset: time of the first sample [s]; default: one period, because samples at rest contain
            no information.

    Raises:
        InputError: no such rows, a period that is not positive, or a negative offset; and, when a
            sample is taken, a state that is not finite or whose quaternion is not of unit norm (to
            1e-3).

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        rows: str = "standard",
        momentum: TotalMomentum | str | None = None,
        period: float = 0.1,
        offset: float | None = None,
    ) -> None:
        super().__init__()
        self.set_name("momentum_identifier")
        if not (is_number(period) and period > 0):
            raise InputError(f"identification period must be > 0 s, not {period}")
        offset = period if offset is None else offset
        if not (is_number(offset) and offset >= 0):
            raise InputError(f"identification offset must be >= 0 s, not {offset}")
        require_spacecraft(spacecraft)
        self._spacecraft = spacecraft
        self._momentum = TotalMomentum.of(momentum) or TotalMomentum.zero()
        if self._momentum.name == "known":
            raise InputError("identification needs a total momentum that is zero or unknown")
        self._family = row_family(rows, self._momentum.is_unknown)
        self._parameterization = self._family.parameterization(spacecraft.mass)
        self._extra = momentum_columns(spacecraft.tree, self._family, self._momentum)
        self._size = self._extra + 11

        self._state_port = self.DeclareVectorInputPort(
            "state", spacecraft.plant.num_multibody_states()
        )
        self._plant_context = self._declare_plant_context(spacecraft.plant)
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
        self.DeclareInitializationDiscreteUpdateEvent(self._begin_run)
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
        period: float = 0.1,
        offset: float | None = None,
    ) -> Self:
        """Add an identifier to a diagram and connect its input; for the options see the class.

        Args:
            builder: the diagram's builder.
            spacecraft: the spacecraft model.
            state: its state. From that of a plant with more bodies, or of another order, the
                spacecraft's own columns are taken.
            rows, momentum, period, offset: see the class.

        Raises:
            InputError: `state` is not that of this spacecraft, or comes from a plant that does not
                conserve momentum, because it is discrete or has gravity.

        """
        identifier = cls(spacecraft, rows=rows, momentum=momentum, period=period, offset=offset)
        require_conservation(spacecraft, state, identifier.get_name())
        return identifier.connected(builder, state=spacecraft_state(builder, spacecraft, state))

    # -- state, rows, QR -----------------------------------------------------------------------

    def _rows(self, context: Context) -> Array | None:
        """Return the rows [N | A | b] of this instant; None if its state is no state yet."""
        x, spacecraft = self._state_port.Eval(context), self._spacecraft
        if not x.any():
            return None
        quaternion_WB = x[spacecraft.state_columns["quaternion_WB"]]
        if not (isfinite(x @ x) and 0.998 < quaternion_WB @ quaternion_WB < 1.002):
            with prefix_errors(self._place(context)):
                spacecraft.to_motion(context.get_time(), x)  # says what is wrong
        plant_context = self._plant_context(context)
        spacecraft.plant.SetPositionsAndVelocities(plant_context, x)
        sample = spacecraft.momentum_sample(plant_context)
        rows = rows_of_samples(spacecraft.tree, sample, self._family, self._momentum)
        if not isfinite(rows.sum()):
            raise InputError(f"{self._place(context)}: its momentum is not finite")
        return rows

    def _place(self, context: Context) -> str:
        return f"{self.GetSystemPathname()}: the state at t = {context.get_time():g} s"

    def _take_sample(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        samples, row_count, latest = context.get_discrete_state(self._count_index).value()
        if context.get_time() == latest:  # `Finish` took this sample, and the run goes on
            return EventStatus.DidNothing()
        rows = self._rows(context)
        if rows is None:
            return EventStatus.DidNothing()
        # [R z; 0 ρ] of all rows: QR of the triangle so far with the new rows below it.
        root = updated_information(self._root(context), rows).ravel()
        discrete_state.set_value(self._root_index, root)
        if int(samples + 1).bit_count() == 1:
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

    def _begin_run(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        """Let a run whose time was set back add its samples to those of the runs before."""
        samples, row_count, latest = context.get_discrete_state(self._count_index).value()
        if context.get_time() < latest:
            discrete_state.set_value(self._count_index, [samples, row_count, -np.inf])
        return EventStatus.Succeeded()

    def _root(self, context: Context) -> Array:
        root = context.get_discrete_state(self._root_index).value()
        return np.asarray(root.reshape(self._size, self._size))

    def _earlier(self, context: Context) -> Array:
        return np.asarray(context.get_discrete_state(self._earlier_index).value())

    # -- outputs -------------------------------------------------------------------------------

    def _solution(self, context: Context) -> tuple[int, Array, LeastSquaresSolution]:
        """Return the number of samples, [R z] of the target, and its solution R x = z."""
        samples, row_count, _ = context.get_discrete_state(self._count_index).value()
        rows = self._root(context)[self._extra :, self._extra :]
        return int(samples), rows, solution_of_triangle(rows, int(row_count) - self._extra)

    def _estimate(self, context: Context) -> Estimate:
        samples, _, solution = self._solution(context)
        quantile = quantile_95(solution.row_count - solution.rank)
        parameters, covariance, _ = determined_parameters(
            self._parameterization, solution, quantile
        )
        numbers = [samples, solution.rank, solution.condition_number, solution.residual_rms]
        return parameters, covariance, numbers

    def _identify(self, context: Context) -> "Identification":
        from cpid_drake.identification.row_checks import identification_of_rows

        samples, rows, solution = self._solution(context)
        first = self._earlier(context)[: self._size**2].reshape(self._size, self._size)
        return identification_of_rows(
            self._family,
            self._momentum,
            self._spacecraft.tree,
            solution,
            samples,
            earlier=first[self._extra :, self._extra :],
            rows=rows,
        )

    def _passed(self, result: "Identification") -> bool:
        from cpid_drake.identification.checks import CONSERVATION

        return result.check(CONSERVATION) is not None and result.passed
