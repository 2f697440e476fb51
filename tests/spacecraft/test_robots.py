"""Robots that nobody here wrote: each is read as Pinocchio reads it, or refused for a reason."""

import importlib.metadata
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from cpid_drake import InputError, Spacecraft

REASONS = (
    "no rigid body has the mass",
    "couple its joints",
    "cannot mimic joint",
    "is welded to the world",
    "is not read",
    "No frame named",
)


def robots() -> list[Path]:
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    return sorted(Path(str(file.locate())).resolve() for file in files if file.suffix == ".urdf")


def ends(path: Path) -> tuple[str, list[str]]:
    """Return the first link of a robot, and those that hold no other link."""
    robot = ElementTree.parse(path).getroot()
    joints = [each for each in robot.findall("joint") if each.find("child") is not None]
    parents, children = (
        {each.find(end).get("link") for each in joints} for end in ("parent", "child")
    )
    links = [each.get("name") for each in robot.findall("link")]
    return next(n for n in links if n not in children), [n for n in links if n not in parents]


@pytest.mark.slow
@pytest.mark.skipif(not robots(), reason="needs pip install example-robot-data")
def test_each_robot_is_as_pinocchio_reads_it_or_refused_with_a_reason():
    """Mass, and centre of mass at some joint positions, of all that are read."""
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
        model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
        data, q, context = (
            model.createData(),
            pin.neutral(model),
            craft.plant.CreateDefaultContext(),
        )
        positions = craft.plant.GetPositions(context)
        for k, name in enumerate(craft.joint_names):
            own = model.joints[model.getJointId(name)]
            angle = 0.5 * np.sin(k + 1.0)
            positions[craft.state_columns["q"][k]] = angle
            turn = [np.cos(angle), np.sin(angle)]  # Pinocchio's joints without limits
            q[own.idx_q : own.idx_q + own.nq] = turn if own.nq == 2 else angle
        craft.plant.SetPositions(context, positions)
        c = pin.centerOfMass(model, data, q)
        assert craft.mass == pytest.approx(data.mass[0])
        ours = craft.plant.CalcCenterOfMassPositionInWorld(context)
        np.testing.assert_allclose(ours, c, atol=1e-9, err_msg=path.stem)
    assert len(read) > 25
    for name, message in refused.items():
        assert any(reason in message for reason in REASONS), f"{name}: {message}"
        assert "\n" not in message
