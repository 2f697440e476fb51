"""The text of model files in URDF, SDF and MJCF, from a list of links."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw

from cpid_drake.dynamics.inertia import InertialParameters

WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
"""Comment at the beginning of every file."""

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@dataclass(frozen=True, eq=False)
class Link:
    """A link and the joint to its parent, whose frame at q = 0 is the link's own frame L.

    Attributes:
        body: mass, centre of mass and inertia in L; None without mass.
        kind: "revolute", "prismatic" or "fixed"; empty for the first link, which is free.
        limits: lowest and highest position, and largest rate; infinite for none.

    """

    name: str
    body: InertialParameters | None
    parent: str = ""
    joint: str = ""
    kind: str = ""
    X_PL: RigidTransform = field(default_factory=RigidTransform)
    axis_L: NDArray[np.float64] | None = None
    limits: tuple[float, float, float] = (-np.inf, np.inf, np.inf)

    @property
    def finite_limits(self) -> dict[str, str]:
        """The limits that are not infinite, by their names in URDF and SDF."""
        named = zip(("lower", "upper", "velocity"), self.limits, strict=True)
        return {name: _numbers(value) for name, value in named if np.isfinite(value)}


def _numbers(*values: ArrayLike) -> str:
    numbers = np.concatenate([np.ravel(np.asarray(each, dtype=float)) for each in values])
    # Some readers refuse numbers below the smallest normal number.
    numbers = np.where(np.abs(numbers) < sys.float_info.min, 0.0, numbers)
    return " ".join(map(repr, numbers.tolist()))


def _pose(X: RigidTransform) -> tuple[str, str]:
    """Return position, and roll, pitch and yaw."""
    return _numbers(X.translation()), _numbers(RollPitchYaw(X.rotation()).vector())


def _moments(body: InertialParameters) -> dict[str, str]:
    return dict(zip(_MOMENTS, map(_numbers, body.to_vector()[4:]), strict=True))


def _text(root: Element) -> str:
    root.insert(0, Comment(f" {WHAT} "))
    indent(root)
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'


def _sub(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text


def _urdf(links: Sequence[Link]) -> str:
    robot = Element("robot", name=links[0].name)
    for link in links:
        element = SubElement(robot, "link", name=link.name)
        if link.body is not None:
            inertial = SubElement(element, "inertial")
            SubElement(inertial, "origin", xyz=_numbers(link.body.p_CTcm_C), rpy="0 0 0")
            SubElement(inertial, "mass", value=_numbers(link.body.mass))
            SubElement(inertial, "inertia", _moments(link.body))
        if not link.kind:
            continue
        limits = link.finite_limits
        kind = "continuous" if link.kind == "revolute" and not limits else link.kind
        joint = SubElement(robot, "joint", name=link.joint, type=kind)
        SubElement(joint, "parent", link=link.parent)
        SubElement(joint, "child", link=link.name)
        xyz, rpy = _pose(link.X_PL)
        SubElement(joint, "origin", xyz=xyz, rpy=rpy)
        if link.axis_L is not None:
            SubElement(joint, "axis", xyz=_numbers(link.axis_L))
        if limits:  # URDF requires an effort; 0 means that none is stated
            SubElement(joint, "limit", limits | {"effort": "0"})
    return _text(robot)


def _sdf(links: Sequence[Link]) -> str:
    sdf = Element("sdf", version="1.9")
    model = SubElement(sdf, "model", name=links[0].name)
    for link in links:
        if link.kind == "fixed" and link.body is None:  # readers give a link without mass 1 kg
            frame = SubElement(model, "frame", {"name": link.name, "attached_to": link.parent})
            _sub(frame, "pose", " ".join(_pose(link.X_PL)))
            continue
        element = SubElement(model, "link", name=link.name)
        if link.kind:
            pose = SubElement(element, "pose", relative_to=link.parent)
            pose.text = " ".join(_pose(link.X_PL))
        if link.body is not None:
            inertial = SubElement(element, "inertial")
            _sub(inertial, "pose", _numbers(link.body.p_CTcm_C, np.zeros(3)))
            _sub(inertial, "mass", _numbers(link.body.mass))
            inertia = SubElement(inertial, "inertia")
            for key, value in _moments(link.body).items():
                _sub(inertia, key, value)
        if not link.kind:
            continue
        joint = SubElement(model, "joint", name=link.joint, type=link.kind)
        _sub(joint, "parent", link.parent)
        _sub(joint, "child", link.name)
        if link.axis_L is not None:
            axis = SubElement(joint, "axis")
            _sub(axis, "xyz", _numbers(link.axis_L))
            limit = SubElement(axis, "limit")
            for key, value in link.finite_limits.items():
                _sub(limit, key, value)
    return _text(sdf)


def _mjcf(links: Sequence[Link]) -> str:
    mujoco = Element("mujoco", model=links[0].name)
    SubElement(mujoco, "compiler", angle="radian")
    bodies = {"": SubElement(mujoco, "worldbody")}
    for link in links:
        body = bodies[link.name] = SubElement(bodies[link.parent], "body", name=link.name)
        if link.kind:
            body.set("pos", _numbers(link.X_PL.translation()))
            body.set("quat", _numbers(link.X_PL.rotation().ToQuaternion().wxyz()))
        else:
            SubElement(body, "freejoint")
        if link.axis_L is not None:
            kind = "hinge" if link.kind == "revolute" else "slide"
            axis = _numbers(link.axis_L)
            joint = SubElement(body, "joint", name=link.joint, type=kind, axis=axis)
            if np.isfinite(link.limits[:2]).all():
                joint.attrib |= {"limited": "true", "range": _numbers(link.limits[:2])}
        if link.body is not None:
            mass, *_ = vector = link.body.to_vector()
            inertial = SubElement(body, "inertial", pos=_numbers(vector[1:4]), mass=_numbers(mass))
            inertial.set("fullinertia", _numbers(vector[4:]))
    return _text(mujoco)


WRITERS = {"urdf": _urdf, "sdf": _sdf, "mjcf": _mjcf}
"""By format, the function from links, inboard before outboard, to text."""
