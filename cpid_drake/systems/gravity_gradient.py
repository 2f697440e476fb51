"""The gravity gradient of an orbit on a simulated spacecraft, as a Drake system."""

import numpy as np
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder

from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.systems.spatial_forces import SpatialForces, force_on


class GravityGradient(SpatialForces):
    """Applies force and torque of an orbit's gravity gradient to every body of a plant.

    The force acts at the body's centre of mass: W's origin moves along the orbit, so that only the
    difference of gravity between the two points remains.

    .. pydrake_system::

        name: GravityGradient
        input_ports:
        - state
        output_ports:
        - spatial_forces

    - `state`: x = [q; v] of the plant.
    - `spatial_forces`: for `MultibodyPlant.get_applied_spatial_force_input_port()`.

    Args:
        plant: the finalized plant of spacecraft and target.
        orbit: the orbit of W's origin.

    """

    def __init__(self, plant: MultibodyPlant, orbit: Orbit) -> None:
        super().__init__("gravity_gradient", plant, self.time_ticket())
        self._orbit = orbit
        indices = map(BodyIndex, range(1, plant.num_bodies()))  # 0 is the world
        self._bodies: list[RigidBody] = []
        inertias = []
        for body in map(plant.get_body, indices):
            inertia = body.CalcSpatialInertiaInBodyFrame(self._scratch.context)
            if inertia.get_mass() > 0:
                self._bodies.append(body)
                inertias.append(inertia)
        self._masses = np.array([inertia.get_mass() for inertia in inertias])
        self._coms = np.array([inertia.get_com() for inertia in inertias])
        self._central = np.array(
            [i.Shift(i.get_com()).CalcRotationalInertia().CopyToFullMatrix3() for i in inertias]
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder, *, plant: MultibodyPlant, orbit: Orbit
    ) -> "GravityGradient":
        """Add a system and connect its input; see the constructor and `SpatialForces`."""
        return GravityGradient(plant, orbit)._added(builder)

    def _forces(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        scratch, time = self._plant_context(context), np.array([context.get_time()])
        poses = [body.EvalPoseInWorld(scratch) for body in self._bodies]
        R = np.array([pose.rotation().matrix() for pose in poses])
        p_WBcm = np.array([pose.translation() for pose in poses]) + rotate(R, self._coms)
        force_W = self._masses[:, None] * (p_WBcm @ self._orbit.tide(time)[0].T)
        inertia_W = R @ self._central @ np.swapaxes(R, -1, -2)
        torque_W = self._orbit.torque(inertia_W, np.repeat(time, len(R)))
        return [force_on(*each) for each in zip(self._bodies, self._coms, torque_W, force_W)]
