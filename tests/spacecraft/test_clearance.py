"""Distances between bodies that are not neighbours, against distances known by construction."""

import numpy as np
import pytest
from model_parts import BALANCED, joint, link

from cpid_drake import InertialParameters, InputError, Spacecraft
from cpid_drake.spacecraft.clearance import Clearance

BALL = InertialParameters(5.0, np.zeros(3), 0.1 * np.eye(3))


def part(name: str, shape: str = "", z: float = 0.0) -> str:
    collision = f'<collision><origin xyz="0 0 {z}"/><geometry>{shape}</geometry></collision>'
    return link(name, 2, collision if shape else "", **BALANCED)


def about_y(name: str, parent: str, child: str, xyz: str) -> str:
    return joint(name, parent, child, "revolute", "0 1 0", xyz, "0 0 0", (-3, 3))


SPHERE = '<sphere radius="0.1"/>'
# An arm of three joints about y, 1 m and 1.1 m apart along z, with spheres of 0.1 m. The upper
# arm's sphere overlaps the base's, and the hand's overlaps the forearm's: these are neighbours.
PARTS = {
    "base": part("base", SPHERE),
    "upper": part("upper", SPHERE, 0.05),
    "fore": part("fore", SPHERE, 0.95),
    "hand": part("hand", SPHERE),
    "shoulder": about_y("shoulder", "base", "upper", "0 0 0"),
    "elbow": about_y("elbow", "upper", "fore", "0 0 1"),
    "wrist": about_y("wrist", "fore", "hand", "0 0 1.1"),
}


@pytest.fixture
def craft(tmp_path):
    """Return a function (changed parts) -> spacecraft of a base with an arm."""

    def make(**changes) -> Spacecraft:
        path = tmp_path / "craft.urdf"
        path.write_text(f'<robot name="craft">{"".join((PARTS | changes).values())}</robot>')
        return Spacecraft(path, base="base", capture_frame="hand")

    return make


def test_the_smallest_distance_is_that_of_the_geometry(craft):
    """From base to hand by the law of cosines; nearer bodies are one or two joints apart."""
    spacecraft, elbow = craft(), 2.0
    clearance = Clearance(spacecraft, BALL)
    motion = np.array([(0.0, 0.0, 0.0), (0.3, 1.0, 0.2), (0.7, elbow, 0.4), (0.9, 1.5, 0)])
    (least,) = clearance.approaches(motion)
    assert (least.bodies, least.sample) == (("base", "hand"), 2)
    expected = np.sqrt(1.0 + 1.1**2 + 2 * 1.1 * np.cos(elbow)) - 0.2
    assert least.distance == pytest.approx(expected, abs=1e-6)
    assert clearance.shapeless == ("captured_target",)


def test_bodies_of_the_same_name_are_told_apart(craft, tmp_path):
    """Two instances of an arm, 5 m apart: each upper arm is near the other's, and not its own."""
    craft()
    path = tmp_path / "two.dmd.yaml"
    path.write_text(
        "directives:\n"
        f"- add_model: {{name: left, file: 'file://{tmp_path}/craft.urdf'}}\n"
        f"- add_model: {{name: right, file: 'file://{tmp_path}/craft.urdf'}}\n"
        "- add_weld: {parent: 'left::base', child: 'right::base', X_PC: {translation: [5, 0, 0]}}\n"
    )
    spacecraft = Spacecraft(path, base="left::base", capture_frame="left::hand")
    at = {name: k for k, name in enumerate(spacecraft.joint_names)}
    q = np.zeros((1, 6))
    q[0, at["left::shoulder"]], q[0, at["right::shoulder"]] = np.pi / 2, -np.pi / 2
    (least,) = Clearance(spacecraft, BALL).approaches(q)
    assert least.bodies == ("left::hand", "right::hand")
    assert least.distance == pytest.approx(5.0 - 2 * 2.1 - 0.2, abs=1e-6)


def test_overlaps_have_their_depth_and_sample(craft):
    """The arm folds by π at the elbow: its spheres are then in line with the base's."""
    spacecraft = craft()
    motion = np.array([(0, 0, 0), (0, 3.1, 0), (0, np.pi, 0), (0, 1.0, 0)])
    found = Clearance(spacecraft, BALL).approaches(motion)
    depths = [(("base", "fore"), -0.15), (("base", "hand"), -0.1), (("hand", "upper"), -0.05)]
    assert [each.bodies for each in found] == [bodies for bodies, _ in depths]
    for each, (_, distance) in zip(found, depths, strict=True):
        assert each.sample == 2
        assert each.distance == pytest.approx(distance, abs=1e-6)


def test_the_target_has_the_collision_geometry_of_its_model(craft, tmp_path):
    """Its sphere is 0.5 m below the hand of the stretched arm, nearer to the base."""
    model = tmp_path / "target.urdf"
    model.write_text(f'<robot name="target">{part("target", SPHERE, -0.5)}</robot>')
    spacecraft = craft()
    clearance = Clearance(spacecraft, BALL, model)
    assert clearance.shapeless == ()
    (least,) = clearance.approaches(np.zeros((1, 3)))
    assert least.bodies == ("base", "captured_target")
    assert least.distance == pytest.approx(2.1 - 0.5 - 0.2, abs=1e-6)


def test_geometry_that_cannot_be_read_is_refused(craft):
    spacecraft = craft(fore=part("fore", '<mesh filename="package://nowhere/fore.obj"/>'))
    with pytest.raises(InputError, match="nowhere"):
        Clearance(spacecraft, BALL)
