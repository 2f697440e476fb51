"""The base as the body that floats: a model may weld it to the world, or begin at another link."""

from collections import defaultdict
from collections.abc import Iterator

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, QuaternionFloatingJoint, RigidBody, WeldJoint

from cpid_drake.files.errors import InputError


def joints_of(plant: MultibodyPlant) -> list[Joint]:
    """Return all joints of a plant."""
    return [plant.get_joint(k) for k in plant.GetJointIndices()]


def connected(plant: MultibodyPlant, body: RigidBody) -> Iterator[tuple[RigidBody, list[Joint]]]:
    """Yield the bodies that joints connect to one, itself first, and the joints between.

    The last is the world, if a joint leads to it; none is reached through the world.
    """
    beside = defaultdict[int, list[tuple[RigidBody, Joint]]](list)
    for joint in joints_of(plant):
        ends = joint.parent_body(), joint.child_body()
        for near, far in (ends, ends[::-1]):
            beside[int(near.index())].append((far, joint))
    world = plant.world_body().index()
    paths: dict[int, list[Joint]] = {int(body.index()): []}
    queue, last = [body], list[tuple[RigidBody, list[Joint]]]()
    for inner in queue:
        path = paths[int(inner.index())]
        yield inner, path
        for far, joint in beside[int(inner.index())]:
            if int(far.index()) in paths:
                continue
            paths[int(far.index())] = [*path, joint]
            if far.index() == world:
                last = [(far, [*path, joint])]
            else:
                queue.append(far)
    yield from last


def free_base(plant: MultibodyPlant, base: RigidBody, where: str) -> str:
    """Let the base of a plant that is not finalized float, and return what was changed, in words.

    A weld that holds it in the world is taken out. If the model's tree begins at another link, the
    joints between are seen from the base.

    Raises:
        InputError: the base is the world.

    """
    world = plant.world_body()
    if base.index() == world.index():
        raise InputError(
            f"{where}: the world is no base: name the link that floats, such as the one that the "
            "model joins to the world"
        )
    note, (last, path) = "", [*connected(plant, base)][-1]
    if last.index() == world.index() and all(isinstance(joint, WeldJoint) for joint in path):
        ends = path[-1].parent_body(), path[-1].child_body()
        link = next(body.name() for body in ends if body.index() != world.index())
        note = f"link '{link}' is welded to the world in the model, and floats freely here"
        plant.RemoveJoint(path[-1])
    # A free joint of another link of the tree, and the joints through which it holds the base.
    tree = {int(body.index()) for body, _ in connected(plant, base)}
    inboard = [j for j in joints_of(plant) if j.child_body().index() == base.index()]
    holders = [
        joint
        for joint in joints_of(plant)
        if isinstance(joint, QuaternionFloatingJoint) and int(joint.child_body().index()) in tree
    ]
    is_free = any(isinstance(joint, QuaternionFloatingJoint) for joint in inboard)
    if not is_free and (holders or (inboard and int(world.index()) not in tree)):
        for joint in holders:
            plant.RemoveJoint(joint)
        name, frames = base.name(), (world.body_frame(), base.body_frame())
        while plant.HasJointNamed(name, base.model_instance()):
            name += "_"
        plant.AddJoint(QuaternionFloatingJoint(name, *frames))
    return note


def floating_joint(plant: MultibodyPlant, base: RigidBody) -> QuaternionFloatingJoint:
    """Return the joint on which a base floats freely in W, with a quaternion as attitude.

    Raises:
        InputError: the base is on another joint.

    """
    for joint in joints_of(plant):
        frames = joint.frame_on_parent(), joint.frame_on_child()
        if (
            isinstance(joint, QuaternionFloatingJoint)
            and joint.child_body().index() == base.index()
            and all(frame.is_body_frame() for frame in frames)
        ):
            return joint
    raise InputError(
        f"the base '{base.name()}' must float freely in the plant, with a quaternion as attitude "
        "(QuaternionFloatingJoint from world), not with roll, pitch and yaw or on another joint"
    )
