"""A mass on a spring inside a body: propellant that sloshes, or the first mode of a wing."""

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiagramBuilder,
)

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError, choose_from
from cpid_drake.systems.spatial_forces import SpatialForces, force_on


class SprungMass(SpatialForces):
    """Moves a part of a body's mass as a point mass on a spring and a damper.

    The point mass S is a part of the body's mass in the model. At rest it is at a given place in
    the body, so the body is then the same as in the model. The spring is equally stiff in all
    directions. Spring and damper act on the body at the current place of the mass, so linear and
    angular momentum are conserved.

    .. pydrake_system::

        name: SprungMass
        input_ports:
        - state
        output_ports:
        - spatial_forces
        - relative_momentum
        - relative_moment

    - `state`: x = [q; v] of the plant.
    - `spatial_forces`: the force on the body, for
      `MultibodyPlant.get_applied_spatial_force_input_port()`.
    - `relative_momentum` (6): momentum [L; P] about W's origin, in W, of the moving mass minus that
      of the same mass fixed in the body.
    - `relative_moment` (3): mass times displacement from its place at rest, in W [kg·m].

    Its continuous state is the position and the velocity of the mass in W.

    Args:
        plant: the finalized plant of spacecraft and target.
        body: name of the body.
        p_BS: (3,) place of the mass at rest, in the body's frame [m].
        mass: [kg].
        frequency: natural frequency with the body held fixed [Hz].
        damping_ratio: of this oscillation.

    Raises:
        InputError: no such body, or what remains of the body is not a rigid body.

    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        body: str,
        p_BS: NDArray[np.float64],
        mass: float,
        frequency: float,
        damping_ratio: float,
    ) -> None:
        super().__init__(f"sprung_mass_in_{body}", plant, self.xc_ticket())
        self._mass, self._p_BS = mass, np.asarray(p_BS, dtype=float)
        self._body = _body(plant, body)
        whole = InertialParameters.from_spatial_inertia(self._body.default_spatial_inertia())
        part = InertialParameters(mass, self._p_BS, np.zeros((3, 3)))
        rest = whole.to_standard_vector() - part.to_standard_vector()
        problems = ["no mass remains"] if rest[0] <= 0 else []
        problems = problems or list(InertialParameters.from_standard_vector(rest).infeasibilities())
        if problems:
            raise InputError(f"a sprung mass of {mass:g} kg in {body}: {'; '.join(problems)}")
        self._rest = InertialParameters.from_standard_vector(rest)
        w = 2 * np.pi * frequency
        self._stiffness, self._damping = mass * w**2, 2 * damping_ratio * mass * w
        self._index = self.DeclareContinuousState(3, 3, 0)
        sources = {self.all_input_ports_ticket(), self.xc_ticket()}
        self.DeclareVectorOutputPort(
            name="relative_momentum",
            size=6,
            calc=self._calc_relative_momentum,
            prerequisites_of_calc=sources,
        )
        self.DeclareVectorOutputPort(
            name="relative_moment",
            size=3,
            calc=self._calc_relative_moment,
            prerequisites_of_calc=sources,
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant,
        *,
        body: str,
        p_BS: NDArray[np.float64],
        mass: float,
        frequency: float,
        damping_ratio: float,
    ) -> "SprungMass":
        """Add a sprung mass and connect its input; see the constructor and `SpatialForces`."""
        system = SprungMass(
            plant,
            body=body,
            p_BS=p_BS,
            mass=mass,
            frequency=frequency,
            damping_ratio=damping_ratio,
        )
        return system._added(builder)

    def start(self, root_context: Context) -> None:
        """Put the mass at rest in the body, and take it out of the rigid body of the plant.

        Args:
            root_context: Context of the diagram, in which the plant has its initial state.

        """
        plant_context = self._plant.GetMyMutableContextFromRoot(root_context)
        place, velocity = self._held(plant_context)
        context = self.GetMyMutableContextFromRoot(root_context)
        context.SetContinuousState(np.concatenate([place, velocity]))
        self._body.SetSpatialInertiaInBodyFrame(plant_context, self._rest.to_spatial_inertia())

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Set velocity and acceleration of the mass."""
        _, velocity = self._moving(context)
        force = self._force(context)
        derivatives.get_mutable_vector().SetFromVector(
            np.concatenate([velocity, -force / self._mass])
        )

    def _moving(self, context: Context) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position and velocity of the mass in W."""
        place, velocity = np.split(context.get_continuous_state_vector().CopyToVector(), 2)
        return place, velocity

    def _held(
        self, plant_context: Context, place: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the place of rest, and the body's velocity there or at another place, in W."""
        X_WB = self._body.EvalPoseInWorld(plant_context)
        V_WB = self._body.EvalSpatialVelocityInWorld(plant_context)
        rest = X_WB @ self._p_BS
        arm = (rest if place is None else place) - X_WB.translation()
        return rest, V_WB.translational() + np.cross(V_WB.rotational(), arm)

    def _force(self, context: Context) -> NDArray[np.float64]:
        """Return the force on the body, in W [N]."""
        place, velocity = self._moving(context)
        rest, v_body = self._held(self._plant_context(context), place)
        return self._stiffness * (place - rest) + self._damping * (velocity - v_body)

    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        place, _ = self._moving(context)
        X_WB = self._body.EvalPoseInWorld(self._plant_context(context))
        return [force_on(self._body, X_WB.inverse() @ place, np.zeros(3), self._force(context))]

    def _calc_relative_momentum(self, context: Context, output: BasicVector) -> None:
        moving = self._moving(context)
        held = self._held(self._plant_context(context))
        P = self._mass * (moving[1] - held[1])
        L = self._mass * (np.cross(*moving) - np.cross(*held))
        output.SetFromVector(np.concatenate([L, P]))

    def _calc_relative_moment(self, context: Context, output: BasicVector) -> None:
        place, _ = self._moving(context)
        rest, _ = self._held(self._plant_context(context))
        output.SetFromVector(self._mass * (place - rest))


def _body(plant: MultibodyPlant, name: str) -> RigidBody:
    """Return the only body of this name in a plant."""
    bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    found = [body for body in bodies if name in (body.name(), body.scoped_name().get_full())]
    if len(found) != 1:
        choices = choose_from(name, [body.name() for body in bodies])
        raise InputError(f"simulation.sprung_masses: no body '{name}'; {choices}")
    return found[0]
