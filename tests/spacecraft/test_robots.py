"""Robots that nobody here wrote: each is read as Pinocchio reads it, or refused for a reason."""

import importlib.metadata
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cpid_drake import InputError, Motion, Spacecraft
from cpid_drake.dynamics.momentum import momentum_samples

pin = pytest.importorskip("pinocchio")

REASONS = ("no rigid body has the mass", "<origin> in <link> is not read")


def robots() -> list[Path]:
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(file.locate())).resolve() for file in files if file.suffix == ".urdf")


def ends(path: Path) -> tuple[str, list[str]]:
    """Return the first link of a robot after the world, and those that hold no other link."""
    robot = ElementTree.parse(path).getroot()
    joints = [each for each in robot.findall("joint") if each.find("child") is not None]
    parents, children = (
        {each.find(end).get("link") for each in joints} for end in ("parent", "child")
    )
    links = [each.get("name") for each in robot.findall("link")]
    first = next(n for n in links if n not in children)
    if first == "world":
        [first, *_] = [
            each.find("child").get("link")
            for each in joints
            if each.find("parent").get("link") == "world"
        ]
    return first, [n for n in links if n not in parents]


def momentum(craft: Spacecraft, path: Path, base: str) -> tuple[np.ndarray, np.ndarray]:
    """Return mass, centre of mass, P, and L about it, by the package and by Pinocchio."""
    model, joints = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()), craft.coupling
    data, rng = model.createData(), np.random.default_rng(3)
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[:3], q[3:7], v[:6] = rng.normal(size=3), pin.neutral(model)[3:7], rng.normal(size=6)
    own, rates = rng.uniform(-1, 1, (2, 1, joints.count))
    values = zip(joints.joints, joints.positions(own[0]), joints.rates(rates[0]), strict=True)
    for each, position, rate in values:
        joint = model.joints[model.getJointId(each.name())]
        turn = [np.cos(position), np.sin(position)]  # Pinocchio's joints without limits
        q[joint.idx_q : joint.idx_q + joint.nq] = turn if joint.nq == 2 else position
        v[joint.idx_v] = rate
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId(base)
    X_WB = data.oMf[frame]
    V_WB = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    pin.computeCentroidalMomentum(model, data, q, v)
    c, total = pin.centerOfMass(model, data, q, v), pin.computeTotalMass(model, data)
    quaternion = pin.Quaternion(X_WB.rotation).coeffs()[[3, 0, 1, 2]]
    poses = (quaternion[None], X_WB.translation[None], V_WB.angular[None], V_WB.linear[None])
    motion = Motion(craft.joint_names, np.zeros(1), *poses, own, rates)
    found = momentum_samples(craft.tree, motion)
    P, p_WKcm = found.P[0], found.p_WKcm[0]
    L = found.L[0] + np.cross(found.motion.p_WC[0] - p_WKcm, P)
    ours = np.concatenate([[craft.mass], p_WKcm, P, L])
    return ours, np.concatenate([[total], c, data.hg.linear, data.hg.angular])


@pytest.mark.slow
@pytest.mark.skipif(not robots(), reason="needs pip install example-robot-data")
def test_each_robot_is_as_pinocchio_reads_it_or_refused_with_a_reason():
    """Mass, centre of mass, P and L of all that are read, at some positions and rates."""
    read, refused = list[str](), dict[str, str]()
    for path in robots():
        if not ElementTree.parse(path).getroot().findall("link"):
            continue  # nothing but an include
        first, last = ends(path)
        try:
            craft = Spacecraft(path, base=first, capture_frame=last[-1])
        except InputError as error:
            refused[path.stem] = str(error)
            continue
        read.append(path.stem)
        ours, theirs = momentum(craft, path, first)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-11, err_msg=path.stem)
    assert len(read) >= 48
    for name, message in refused.items():
        assert any(reason in message for reason in REASONS), f"{name}: {message}"
        assert "\n" not in message
