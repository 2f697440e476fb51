"""Checks that a parsed model is a tree of supported joints on a free base that move C."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    Joint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)

from cpid_drake.spacecraft.lookup import listed
from cpid_drake.spacecraft.parsing import ModelFile


def movable_joints(model: ModelFile, plant: MultibodyPlant) -> list[Joint]:
    """Return the revolute and prismatic joints of a finalized plant, in the order of q.

    Raises:
        InputError: the plant has no such joint.

    """
    movable = [j for j in _joints(plant) if isinstance(j, (RevoluteJoint, PrismaticJoint))]
    if not movable:
        raise model.error("it has no revolute or prismatic joint to move the target with")
    return sorted(movable, key=lambda joint: joint.position_start())


def require_tree_on_free_base(
    model: ModelFile, plant: MultibodyPlant, base: RigidBody, capture_frame: Frame
) -> None:
    """Check that a finalized plant has one free base with all other bodies, and that C can move.

    Raises:
        InputError: the base is welded to the world or does not float, a body is not connected to
            it, no joint moves C relative to it, a joint is of a type that is not supported, or a
            body that joints move has a geometry and no inertia.

    """
    _require_free_base(model, plant, base)
    _require_free_capture_frame(model, plant, capture_frame)
    for joint in _joints(plant):
        of_base = (
            isinstance(joint, QuaternionFloatingJoint)
            and joint.child_body().index() == base.index()
        )
        if not of_base and not isinstance(joint, (RevoluteJoint, PrismaticJoint, WeldJoint)):
            raise model.error(
                f"joint '{joint.name()}' is of type {joint.type_name()}; only revolute, "
                "prismatic and fixed joints are supported"
            )
        if not of_base and not isinstance(joint, WeldJoint):
            for body in (joint.parent_body(), joint.child_body()):
                _require_inertia(model, plant, body)


def _require_inertia(model: ModelFile, plant: MultibodyPlant, body: RigidBody) -> None:
    """Refuse bodies that are welded together and have a geometry, but no inertia in their file."""
    welded = plant.GetBodiesWeldedTo(body)
    hollow = [each.name() for each in welded if each.name() in model.contents.hollow]
    if hollow and not any(b.default_mass() > 0 and b.name() not in hollow for b in welded):
        raise model.error(
            f"link '{hollow[0]}' moves and has a geometry but no <inertial>: give it a mass and an "
            "inertia"
        )


def _joints(plant: MultibodyPlant) -> list[Joint]:
    return [plant.get_joint(k) for k in plant.GetJointIndices()]


def _require_free_base(model: ModelFile, plant: MultibodyPlant, base: RigidBody) -> None:
    floating = [plant.get_body(k) for k in sorted(plant.GetFloatingBaseBodies(), key=int)]
    if plant.IsAnchored(base):
        raise model.error(
            f"base '{base.name()}' is welded to the world{_weld_to_world(plant)}; a "
            "spacecraft's base must be free. Take that weld out of a copy of the file (MJCF: "
            "add a freejoint); to put an arm on a base, write model directives (.dmd.yaml): "
            "add_model the base, add_model the arm, add_weld with parent BASE::LINK and child "
            "ARM::FIRST_LINK"
        )
    if base.index() not in [body.index() for body in floating]:
        names = listed(body.name() for body in floating)
        raise model.error(
            f"'{base.name()}' is not the floating base; free bodies are: {names or 'none'}"
        )
    if len(floating) > 1:
        loose = listed(body.name() for body in floating if body.index() != base.index())
        raise model.error(f"bodies not connected to the base '{base.name()}': {loose}")


def _require_free_capture_frame(
    model: ModelFile, plant: MultibodyPlant, capture_frame: Frame
) -> None:
    if plant.IsAnchored(capture_frame.body()):
        raise model.error(f"capture frame '{capture_frame.name()}' is fixed in the world")


def _weld_to_world(plant: MultibodyPlant) -> str:
    """Return a text that names the joints that weld a body to the world."""
    welds = [
        f"{joint.name()} (on {joint.child_body().name()})"
        for joint in _joints(plant)
        if isinstance(joint, WeldJoint)
        and joint.parent_body().index() == plant.world_body().index()
    ]
    return f" by {listed(welds)}" if welds else ""
