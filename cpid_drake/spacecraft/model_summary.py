"""What a model file offers: a base, capture frames, joints, and bodies that need a second look."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, FrameIndex, Joint, RigidBody, WeldJoint

from cpid_drake.files.resources import package_folders
from cpid_drake.spacecraft.floating_base import connected, joints_of
from cpid_drake.spacecraft.link_inertia import BodyFinding
from cpid_drake.spacecraft.mimic_joints import Mimic
from cpid_drake.spacecraft.model_file import ModelFile
from cpid_drake.spacecraft.plant_names import find_element, unique_names
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class ModelSummary:
    """A model with the base and the capture frame that are given, or else are likely.

    Attributes:
        spacecraft: the model; the nearest bodies are in the place of those that cannot be.
        base: the name of its base.
        capture_frame: the name of its capture frame.
        frames: how many joints carry each frame on offer, by its name, the most first: frames and
            links at the ends of the tree.
        packages: folders, by name, of packages that the model's URIs refer to.

    """

    spacecraft: Spacecraft
    base: str
    capture_frame: str
    frames: Mapping[str, int]
    packages: Mapping[str, str | Path]

    @property
    def findings(self) -> tuple[BodyFinding, ...]:
        """Bodies that cannot be, and those that hardly are these links."""
        return (*self.spacecraft.file.impossible, *self.spacecraft.implausible)


def summarize_model(
    model: str | Path,
    *,
    base: str | None = None,
    capture_frame: str | None = None,
    packages: Mapping[str, str | Path] | None = None,
) -> ModelSummary:
    """Return what a model file offers.

    Args:
        model: a path or a `package://NAME/...` URI.
        base: name of the base; default: the link at which the heaviest tree begins.
        capture_frame: name of the capture frame; default: one that most joints carry besides those
            of a gripper.
        packages: folders, by package name, of other packages that the model's URIs refer to.

    Raises:
        InputError: as for `Spacecraft`, but for bodies that cannot be.

    """
    file, plant = ModelFile(model, package_folders(packages), "nearest"), MultibodyPlant(0.0)
    file.parse_into(plant)
    root = _root(file, plant) if base is None else find_element(plant, "Body", base, file.model)
    frames = _ends(plant, root, file.content.mimics)
    capture_frame = capture_frame or next(iter(frames))
    base = base or _scoped(plant, root)
    spacecraft = Spacecraft(
        model, base=base, capture_frame=capture_frame, packages=packages, repair_bodies="nearest"
    )
    return ModelSummary(spacecraft, base, capture_frame, frames, dict(packages or {}))


def _root(file: ModelFile, plant: MultibodyPlant) -> RigidBody:
    """Return the link at which the heaviest tree of a plant begins."""
    world = plant.world_body().index()
    inboard = {j.child_body().index(): j.parent_body().index() for j in joints_of(plant)}
    bodies = (plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies()))
    roots = [body for body in bodies if inboard.get(body.index(), world) == world]
    if not roots:
        raise file.error("it has no link at which a tree begins")
    return max(roots, key=lambda root: sum(b.default_mass() for b, _ in _tree(plant, root)))


def _scoped(plant: MultibodyPlant, root: RigidBody) -> str:
    """Return the root's name, scoped if others have it."""
    bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    names = unique_names(plant, bodies)
    return names[[body.index() for body in bodies].index(root.index())]


def _tree(plant: MultibodyPlant, root: RigidBody) -> list[tuple[RigidBody, list[Joint]]]:
    """Return the bodies of a tree, root first, with the joints that lead to each."""
    world = plant.world_body().index()
    return [(body, path) for body, path in connected(plant, root) if body.index() != world]


def _ends(
    plant: MultibodyPlant, root: RigidBody, mimics: Mapping[str, Mimic | None]
) -> dict[str, int]:
    """Return by how many joints the frames at the ends of a tree are carried, the most first.

    They are links that carry no other, and frames that are no link's. The joints of a gripper, of
    which some follow others, do not count for the order, and a frame without a mass is first.
    """
    tree, joints = _tree(plant, root), joints_of(plant)
    grippers = {name for name, mimic in mimics.items() if mimic is not None}
    grippers |= {mimic.leader for mimic in mimics.values() if mimic is not None}
    paths = {
        int(body.index()): [joint for joint in path if not isinstance(joint, WeldJoint)]
        for body, path in tree
    }
    inner = {
        int(body.index())
        for outer, path in tree
        for joint in path[-1:]
        for body in (joint.parent_body(), joint.child_body())
        if body.index() != outer.index()
    }
    ends = list[Joint | RigidBody | Frame](b for b, _ in tree if int(b.index()) not in inner)
    of_joints = {f.index() for j in joints for f in (j.frame_on_parent(), j.frame_on_child())}
    for frame in (plant.get_frame(FrameIndex(k)) for k in range(plant.num_frames())):
        is_own = frame.is_body_frame() or frame.index() in of_joints
        if not is_own and frame.name() and int(frame.body().index()) in paths:
            ends.append(frame)

    def order(end: Joint | RigidBody | Frame) -> tuple[int, float]:
        path = paths[_body_index(end)]
        mass = end.default_mass() if isinstance(end, RigidBody) else 0.0
        return -sum(joint.name() not in grippers for joint in path), mass

    ends.sort(key=order)
    names = unique_names(plant, ends)
    return {n: len(paths[_body_index(end)]) for n, end in zip(names, ends, strict=True)}


def _body_index(end: Joint | RigidBody | Frame) -> int:
    return int((end.body() if isinstance(end, Frame) else end).index())
