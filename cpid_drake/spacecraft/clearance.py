"""Distances between the bodies of a spacecraft and its target, from their collision geometry."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    QueryObject,
    SignedDistancePair,
)
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex, RigidBody, WeldJoint
from pydrake.systems.framework import DiagramBuilder

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.reading import unique_names
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
        spacecraft: the known spacecraft.
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
        self._plant, self._scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        spacecraft.add_to(
            self._plant,
            target,
            scene_graph=self._scene_graph,
            target_visual_model=target_visual_model,
        )
        plant = self._plant
        bodies = [plant.get_body(BodyIndex(k)) for k in range(plant.num_bodies())]
        self._names = dict(zip((b.index() for b in bodies), unique_names(plant, bodies)))
        self._near = self._compare_all_but_neighbours()
        self._columns = spacecraft.state_columns["q"]
        self._context = builder.Build().CreateDefaultContext()
        self.shapeless = tuple(
            self._names[body.index()]
            for body in bodies[1:]  # without the world
            if body.default_mass() > 0 and not plant.GetCollisionGeometriesForBody(body)
        )

    def approaches(self, positions: NDArray[np.float64]) -> list[Approach]:
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
        plant, graph = self._plant, self._scene_graph
        plant_context = plant.GetMyMutableContextFromRoot(self._context)
        query = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(self._context))
        found: dict[tuple[str, str], Approach] = {}
        least = np.inf
        q = plant.GetPositions(plant_context)
        for k, joints in enumerate(positions):
            q[self._columns] = joints
            plant.SetPositions(plant_context, q)
            for pair in _computed(query.ComputeSignedDistancePairwiseClosestPoints, max(least, 0)):
                bodies, distance = self._names_of(query, pair), pair.distance
                if distance >= 0 and frozenset(bodies) in self._near:
                    continue
                if bodies not in found or distance < found[bodies].distance:
                    found[bodies] = Approach(bodies, distance, k)
                least = min(least, distance)
        ordered = sorted(found.values(), key=lambda each: each.distance)
        return [each for each in ordered if each.distance < 0] or ordered[:1]

    def penalties(
        self, positions: NDArray[np.float64], least: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a smooth function (N,) of the distances, and its derivatives (N, J).

        It is at most 1 where all bodies that are not neighbours are at least this far apart, and
        above 1 elsewhere.

        Args:
            positions: (N, J) positions of the joints [rad or m], in the spacecraft's order.
            least: smallest distance [m].

        Raises:
            InputError: the distance between two of the shapes cannot be computed.

        """
        context = self._plant.GetMyMutableContextFromRoot(self._context)
        constraint = MinimumDistanceLowerBoundConstraint(
            self._plant, least, context, None, max(least, _INFLUENCE)
        )
        q = self._plant.GetPositions(context)
        values, gradients = np.zeros(len(positions)), np.zeros(positions.shape)
        for k, joints in enumerate(positions):
            q[self._columns] = joints
            [found] = _computed(constraint.Eval, InitializeAutoDiff(q))
            values[k] = found.value()
            if found.derivatives().size:
                gradients[k] = found.derivatives()[self._columns]
        return values, gradients

    def _names_of(self, query: QueryObject, pair: SignedDistancePair) -> tuple[str, str]:
        """Return the names of the bodies of two shapes, in alphabetical order."""
        frames = map(query.inspector().GetFrameId, (pair.id_A, pair.id_B))
        first, second = sorted(
            self._names[self._plant.GetBodyFromFrameId(frame).index()] for frame in frames
        )
        return first, second

    def _compare_all_but_neighbours(self) -> set[frozenset[str]]:
        """Filter the pairs of shapes; return the pairs of bodies that two joints separate."""
        plant = self._plant

        def shapes(bodies: Iterable[RigidBody]) -> GeometrySet:
            return GeometrySet([g for b in bodies for g in plant.GetCollisionGeometriesForBody(b)])

        bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
        filters = CollisionFilterDeclaration().AllowWithin(shapes(bodies))
        for body in bodies:
            filters.ExcludeWithin(shapes(plant.GetBodiesWeldedTo(body)))
        adjacent = defaultdict(list)
        for joint in map(plant.get_joint, plant.GetJointIndices()):
            if not isinstance(joint, WeldJoint):
                ends = (joint.parent_body(), joint.child_body())
                inner, outer = map(plant.GetBodiesWeldedTo, ends)
                filters.ExcludeBetween(shapes(inner), shapes(outer))
                adjacent[inner[0].index()].append(outer)
                adjacent[outer[0].index()].append(inner)
        self._scene_graph.collision_filter_manager().Apply(filters)
        return {
            frozenset((self._names[a.index()], self._names[b.index()]))
            for sides in adjacent.values()
            for first, second in combinations(sides, 2)
            for a, b in product(first, second)
        }


def _computed(distances: Callable, argument: object) -> Any:
    """Return Drake's distances; raises InputError for shapes that it cannot compare."""
    try:
        return distances(argument)
    except RuntimeError as error:
        text = " ".join(str(error).split())
        raise InputError(f"distances cannot be computed: {text}") from error
