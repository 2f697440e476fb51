"""What the identifiers share as Drake systems: their outputs."""

from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import (
    BasicVector,
    CacheEntry,
    Context,
    DependencyTicket,
    OutputPort,
    ValueProducer,
)

from cpid_drake.array import Array
from cpid_drake.systems.ports import SpacecraftSystem

if TYPE_CHECKING:  # half of the package, and no output of a `MomentumIdentifier` needs it
    from cpid_drake.identification.result import Identification

DIAGNOSTICS = ("samples", "rank", "condition", "residual")
"""Entries of the `diagnostics` output, in order."""

Estimate = tuple[Array, Array, list[float]]
"""Parameters (10,), their covariance (10, 10), and the diagnostics."""


class Identifier(SpacecraftSystem):
    """Base class of the identifiers: the outputs of `MomentumIdentifier`, computed on demand.

    Every value is computed once for every state.
    """

    @abstractmethod
    def _identify(self, context: Context) -> "Identification":
        """Return the identification with its nearest rigid body: a function of the state alone."""

    def _estimate(self, context: Context) -> Estimate:
        """Return what the outputs show: a function of the state alone."""
        result = self.identification(context)
        solution = result.solution
        assert solution is not None
        numbers = [result.sample_count, solution.rank, solution.condition_number]
        return result.parameters, result.covariance, [*numbers, solution.residual_rms]

    def _passed(self, result: "Identification") -> bool:
        """Return whether checks were made and none failed."""
        return bool(result.checks) and result.passed

    def identification(self, context: Context) -> "Identification":
        """Return the identification, with its checks. Reading it changes nothing.

        At the end of `Simulator.AdvanceTo` the samples of that very instant are pending;
        `Simulator.AdvancePendingEvents` takes them. `consistency.checked` finds the part of the
        intervals that a rigid body can have.

        Args:
            context: the Context of this system, or of the diagram that contains it.

        """
        result: Identification = self._identification.Eval(self._context_in(context))
        return result

    def Finish(self, root_context: Context) -> "Identification":
        """End a run: use what is still to be used, and return the identification.

        `MomentumIdentifier` takes the sample that is due now, `SensorIdentifier` solves the block
        that is not complete: samples of that block which arrive later are rejected. The Context is
        that of the diagram after the run.
        """
        context = self.GetMyMutableContextFromRoot(root_context)
        self.ExecuteForcedEvents(context)
        return self.identification(context)

    def estimate_ports(self) -> dict[str, OutputPort]:
        """Return the ports that a controller or a visualizer reads, by their names there."""
        names = ("covariance", "spatial_inertia", "checks_passed")
        return {name: self.GetOutputPort(name) for name in names}

    def _context_in(self, context: Context) -> Context:
        """Return the Context of this system in that of a diagram, or the Context itself."""
        try:
            self.ValidateContext(context)
        except RuntimeError:  # of another system
            return self.GetMyContextFromRoot(context)
        return context

    def _declare_outputs(self, state_ticket: DependencyTicket) -> None:
        """Declare the ports; all depend on the state with this ticket."""
        self._estimated = self._cached("estimate", self._estimate, state_ticket)
        self._identification = self._cached("identification", self._identify, state_ticket)
        of_estimate, of_identification = (
            {self.cache_entry_ticket(entry.cache_index())}
            for entry in (self._estimated, self._identification)
        )

        def declare(name: str, size: int, place: int) -> None:
            def calc(context: Context, output: BasicVector) -> None:
                output.SetFromVector(np.ravel(self._estimated.Eval(context)[place]))

            self.DeclareVectorOutputPort(name, size, calc, of_estimate)

        def calc_spatial_inertia(context: Context, output: AbstractValue) -> None:
            output.set_value(self.identification(context).spatial_inertia())

        def calc_checks(context: Context, output: BasicVector) -> None:
            output[0] = self._passed(self.identification(context))

        declare("parameters", 10, 0)
        declare("covariance", 100, 1)
        self.DeclareAbstractOutputPort(
            name="spatial_inertia",
            alloc=lambda: Value(SpatialInertia.NaN()),
            calc=calc_spatial_inertia,
            prerequisites_of_calc=of_identification,
        )
        declare("diagnostics", len(DIAGNOSTICS), 2)
        self.DeclareVectorOutputPort("checks_passed", 1, calc_checks, of_identification)

    def _cached(
        self, name: str, calc: Callable[[Context], object], ticket: DependencyTicket
    ) -> CacheEntry:
        """Declare a cache entry of a value that depends on the state with this ticket."""
        producer = ValueProducer(
            allocate=lambda: AbstractValue.Make(object()),
            calc=lambda context, value: value.set_value(calc(context)),
        )
        return self.DeclareCacheEntry(name, producer, {ticket})


def is_number(value: ArrayLike) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, (int, float, np.number)) and bool(np.isfinite(value))
