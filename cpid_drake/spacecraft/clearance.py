"""Distances between the bodies of a spacecraft and its target, from their collision geometry."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, RigidBody, WeldJoint
from pydrake.systems.framework import DiagramBuilder

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.plant_names import unique_names
from cpid_drake.spacecraft.spacecraft import Spacecraft

_INFLUENCE = 0.05
"""Distance beyond the smallest one at which bodies begin to matter [m]."""


@dataclass(frozen=True)
class Approach:
    """The smallest distance of two bodies during a motion.

    Attributes:
        bodies: the names of the bodies, scoped as `instance::name` where they are not unique.
        distance: the distance [m]; negative if the bodies overlap, by this depth.
        sample: index of the sample at which it is reached.

    """

    bodies: tuple[str, str]
    distance: float
    sample: int


class Clearance:
    """Computes distances between bodies that are not neighbours.

    Neighbours are bodies that are fixed to each other, or that one joint separates: their shapes
    may overlap. The target has the collision geometry of its visual model, and none without it.

    Args:
        spacecraft: the spacecraft model.
        target: the target that it holds.
        target_visual_model: a model file with the target's geometry, if there is one.

    Attributes:
        shapeless: names of the bodies that have mass and no collision geometry.

    Raises:
        InputError: the geometry of the spacecraft or of the target cannot be read.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        target: InertialParameters,
        target_visual_model: str | Path | None = None,
    ) -> None:
        builder = DiagramBuilder()
        plant, graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        spacecraft.add_to(plant, target, scene_graph=graph, target_visual_model=target_visual_model)
        self._plant, self._graph = plant, graph
        self._bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
        self._names = dict(
            zip((body.index() for body in self._bodies), unique_names(plant, self._bodies))
        )
        self._near = self._compare_all_but_neighbours()
        self._columns, self._coupling = spacecraft.joint_columns[0], spacecraft.coupling
        self._context = builder.Build().CreateDefaultContext()
        self.shapeless = tuple(
            self._names[body.index()]
            for body in self._bodies
            if body.default_mass() > 0 and not plant.GetCollisionGeometriesForBody(body)
        )

    def approaches(self, positions: Array) -> list[Approach]:
        """Return the overlaps of bodies during a motion, or else the smallest distance.

        Args:
            positions: (N, J) positions of the joints [rad or m], in the spacecraft's order.

        Returns:
            The smallest distance of every pair of bodies that overlap, the deepest overlap first.
            Without an overlap: the smallest distance of all bodies that at least three joints
            separate; empty if no two such bodies have collision geometry.

        Raises:
            InputError: the distance between two of the shapes cannot be computed.

        """
        plant, nearest = self._plant, dict[frozenset[BodyIndex], tuple[float, int]]()
        context = plant.GetMyMutableContextFromRoot(self._context)
        query = self._graph.get_query_output_port().Eval(
            self._graph.GetMyContextFromRoot(self._context)
        )
        frame, least = query.inspector().GetFrameId, np.inf
        q = plant.GetPositions(context)
        for k, joints in enumerate(positions):
            q[self._columns] = self._coupling.positions(joints)
            plant.SetPositions(context, q)
            for pair in _computed(query.ComputeSignedDistancePairwiseClosestPoints, max(least, 0)):
                bodies = frozenset(
                    plant.GetBodyFromFrameId(frame(shape)).index()
                    for shape in (pair.id_A, pair.id_B)
                )
                if pair.distance < 0 or bodies not in self._near:
                    nearest[bodies] = min(nearest.get(bodies, (np.inf, k)), (pair.distance, k))
                    least = min(least, pair.distance)
        ordered = []
        for bodies, (distance, k) in sorted(nearest.items(), key=lambda each: each[1]):
            first, second = sorted(self._names[body] for body in bodies)
            ordered.append(Approach((first, second), distance, k))
        return [each for each in ordered if each.distance < 0] or ordered[:1]

    def penalties(self, positions: Array, least: float) -> tuple[Array, Array]:
        """Return a smooth function (N,) of the distances, and its derivatives (N, J).

        It is at most 1 where all bodies that are not neighbours are at least this far apart, and
        above 1 elsewhere.

        Args:
            positions: see `approaches`, which also says what is raised.
            least: smallest distance [m].

        """
        context = self._plant.GetMyMutableContextFromRoot(self._context)
        constraint = MinimumDistanceLowerBoundConstraint(
            self._plant, least, context, None, max(least, _INFLUENCE)
        )
        q = self._plant.GetPositions(context)
        values, gradients = np.zeros(len(positions)), np.zeros(positions.shape)
        for k, joints in enumerate(positions):
            q[self._columns] = joints
            [penalties] = _computed(constraint.Eval, InitializeAutoDiff(q))
            values[k] = penalties.value()
            if penalties.derivatives().size:
                gradients[k] = penalties.derivatives()[self._columns]
        return values, gradients

    def _compare_all_but_neighbours(self) -> set[frozenset[BodyIndex]]:
        """Filter the pairs of shapes; return the pairs of bodies that two joints separate."""
        plant = self._plant

        def shapes(bodies: Iterable[RigidBody]) -> GeometrySet:
            return GeometrySet([g for b in bodies for g in plant.GetCollisionGeometriesForBody(b)])

        filters = CollisionFilterDeclaration().AllowWithin(shapes(self._bodies))
        for body in self._bodies:
            filters.ExcludeWithin(shapes(plant.GetBodiesWeldedTo(body)))
        sides = defaultdict(list)  # what each joint of a rigid group holds, by the group
        for joint in map(plant.get_joint, plant.GetJointIndices()):
            if not isinstance(joint, WeldJoint):
                ends = (joint.parent_body(), joint.child_body())
                inner, outer = map(plant.GetBodiesWeldedTo, ends)
                filters.ExcludeBetween(shapes(inner), shapes(outer))
                sides[inner[0].index()].append(outer)
                sides[outer[0].index()].append(inner)
        self._graph.collision_filter_manager().Apply(filters)
        return {
            frozenset((a.index(), b.index()))
            for held in sides.values()
            for first, second in combinations(held, 2)
            for a in first
            for b in second
        }


def _computed(distances: Callable[[Any], Any], argument: object) -> Any:
    """Return Drake's distances; raises InputError for shapes that it cannot compare."""
    try:
        return distances(argument)
    except RuntimeError as error:
        raise InputError(f"distances cannot be computed: {error}") from error
