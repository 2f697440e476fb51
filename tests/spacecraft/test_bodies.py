"""Bodies that cannot be are refused or repaired; those that hardly are, are named."""

import numpy as np
import pytest
from model_parts import joint, link, moments, urdf

from cpid_drake import InertialParameters, InputError, Spacecraft, load_spacecraft
from cpid_drake.spacecraft.target_export import export_target

IMPOSSIBLE = moments(1.0, 1.0, 3.0, 0.2, 0.0, -0.1)
ARM = link("bus", 50.0), link("arm"), joint("j", "bus", "arm")


def mjcf(inertia: str) -> str:
    return (
        '<mujoco model="m"><worldbody><body name="bus"><freejoint/>'
        '<inertial pos="0 0 0" mass="50" diaginertia="5 5 5"/><body name="arm" pos="1 0 0">'
        f'<joint name="j" axis="0 0 1"/><inertial pos=".2 0 0" mass="10" {inertia}/>'
        "</body></body></worldbody></mujoco>"
    )


def sdf(**inertia: float) -> str:
    own = "".join(f"<{key}>{value}</{key}>" for key, value in inertia.items())
    return (
        '<sdf version="1.9"><model name="s"><link name="bus"><inertial><mass>50</mass></inertial>'
        f'</link><link name="arm"><inertial><mass>10</mass>\n<inertia>{own}</inertia></inertial>'
        '</link><joint name="j" type="revolute"><parent>bus</parent><child>arm</child><axis><xyz>'
        "0 0 1</xyz></axis></joint></model></sdf>"
    )


MODELS = {
    ".urdf": urdf(ARM[0], link("arm", **IMPOSSIBLE), ARM[2]),
    ".sdf": sdf(**IMPOSSIBLE),
    ".xml": mjcf('fullinertia="1 1 3 0.2 0 -0.1"'),
}
ROTATED = {".urdf": True, ".sdf": False, ".xml": False}
"""Whether the inertia is in axes of its own."""


@pytest.fixture
def load(tmp_path):
    def make(text: str, ending: str = ".urdf", **options) -> Spacecraft:
        path = tmp_path / f"model{ending}"
        path.write_text(text)
        return Spacecraft(path, base="bus", capture_frame="arm", **options)

    return make


def nearest() -> np.ndarray:
    """Return the second moments, ascending, of the nearest body, by its definition."""
    xx, yy, zz, xy, xz, yz = IMPOSSIBLE.values()
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.linalg.eigvalsh(np.trace(tensor) / 2 * np.eye(3) - tensor)
    assert second[0] < -0.4
    return np.maximum(second, 0.0)


@pytest.mark.parametrize("ending", MODELS)
def test_the_nearest_body_takes_the_place_of_one_that_cannot_be(load, ending, caplog):
    """Its second moment loses the negative eigenvalue; mass and centre of mass stay."""
    with pytest.raises(InputError, match="--repair-bodies nearest"):
        load(MODELS[ending], ending)
    craft = load(MODELS[ending], ending, repair_bodies="nearest")
    [arm] = [body for body in craft.tree.bodies if body.name == "arm"]
    second = np.trace(arm.I_BBcm) / 2 * np.eye(3) - arm.I_BBcm
    np.testing.assert_allclose(np.linalg.eigvalsh(second), nearest(), atol=1e-9)
    assert arm.mass == 10
    [said] = [each for each in caplog.messages if "nearest body" in each]
    assert "link 'arm'" in said
    assert "a change of " in said
    assert craft.file.is_repaired


def test_bodies_without_mass_lose_their_inertia(load):
    text = urdf(*ARM, link("tool", 0.0), joint("k", "arm", "tool", "fixed"))
    with pytest.raises(InputError, match="without a mass the inertia is 0"):
        load(text)
    craft = load(text, repair_bodies="nearest")
    assert craft.mass == load(urdf(*ARM)).mass


def test_a_negative_mass_has_no_nearest_body(load):
    with pytest.raises(InputError, match="link 'arm': no body is nearest to -10 kg"):
        load(urdf(ARM[0], link("arm", -10.0), ARM[2]), repair_bodies="nearest")


def test_all_links_are_counted_and_the_first_named(load):
    hands = [link(f"hand{k}", **IMPOSSIBLE) for k in range(5)]
    joints = [joint(f"k{k}", "arm", f"hand{k}") for k in range(5)]
    with pytest.raises(InputError, match=r"link 'hand0'.* and 3 more; --repair-bodies"):
        load(urdf(*ARM, *hands, *joints))


def test_a_repaired_spacecraft_is_the_same_in_files_and_copies(load, tmp_path):
    craft = load(MODELS[".urdf"], repair_bodies="nearest")
    (tmp_path / "craft.yaml").write_text(
        "model: model.urdf\nbase: bus\ncapture_frame: arm\nrepair_bodies: nearest\n"
    )
    again = load_spacecraft(tmp_path / "craft.yaml").make()
    target = InertialParameters(9.0, [0.1, 0, 0], np.eye(3))
    export_target(tmp_path / "out.urdf", target, format="urdf", spacecraft=craft)
    exported = Spacecraft(tmp_path / "out.urdf", base="bus", capture_frame="arm")
    for other in (again, exported):
        ours, theirs = craft.tree.bodies[1].I_BBcm, other.tree.bodies[1].I_BBcm
        np.testing.assert_allclose(theirs, ours, atol=1e-11)
    with pytest.raises(InputError, match="bodies are repaired, and directives name its own file"):
        export_target(tmp_path / "o.dmd.yaml", target, format="drake-yaml", spacecraft=craft)


SMALL = link("arm", 0.08, com="0.13 0 0", **moments(0.097, 0.097, 0.097))
DRAWN = '<visual><geometry><box size="{0} {0} {0}"/></geometry></visual>'
IMPLAUSIBLE = {
    "an inertia of another size": (SMALL, "0.08 kg with a radius of gyration of 1.1 m"),
    "smaller geometry": (
        SMALL.replace("</link>", DRAWN.format(0.2) + "</link>"),
        f"its geometry is within {np.hypot(0.23, np.hypot(0.1, 0.1)):.2g} m",
    ),
    "a copy": (
        link("arm", 1.0, com="2 0 0", **moments(2.0, 3.0, 4.0, 0.1, -0.2, 0.3)),
        "1.0 kg with the inertia of 'bus', of 50.0 kg",
    ),
}


@pytest.mark.parametrize("name", IMPLAUSIBLE)
def test_a_body_that_hardly_is_this_link_is_named(load, name, caplog):
    arm, says = IMPLAUSIBLE[name]
    craft = load(urdf(ARM[0], arm, ARM[2]))
    [said] = [each for each in caplog.messages if "implausible" in each]
    assert says in said
    assert "link 'arm'" in said
    assert craft.implausible


PLAUSIBLE = {
    "large geometry": SMALL.replace("</link>", DRAWN.format(3.0) + "</link>"),
    "a rod": link("arm", 2.0, com="0.5 0 0", com_rpy="0 0 0", **moments(0.001, 0.17, 0.17)),
    "a wheel at its joint": link("arm", 4.0, com="0 0 0", **moments(0.04, 0.02, 0.02)),
    "a twin": link("arm", 40.0),
}


@pytest.mark.parametrize("name", PLAUSIBLE)
def test_what_may_well_be_is_not(load, name, caplog):
    assert not load(urdf(ARM[0], PLAUSIBLE[name], ARM[2])).implausible
    assert not caplog.messages


@pytest.mark.parametrize("model", ["dual_arm_servicer", "free_flyer"])
def test_the_shipped_models_are_plausible(model):
    from cpid_drake.files.resources import models_directory

    [path] = (models_directory() / model).glob("*.urdf")
    base = {"dual_arm_servicer": "bus", "free_flyer": "body"}[model]
    assert not Spacecraft(path, base=base, capture_frame="capture_point").implausible
