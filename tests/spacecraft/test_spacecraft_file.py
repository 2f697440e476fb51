"""A spacecraft's own file, and a scenario, say to Python what they say to the command line."""

import pytest

from cpid_drake import InputError, load_spacecraft
from cpid_drake.files.resources import models_directory

FILE = """
model: {models}/free_flyer/free_flyer.urdf
base: body
capture_frame: capture_point
sensors: testbed
momentum: unknown
known_bodies: {{mass: 0.02}}
"""


def test_a_file_and_a_scenario_are_the_same_spacecraft(tmp_path):
    own = tmp_path / "craft.yaml"
    own.write_text(FILE.format(models=models_directory()))
    found, shipped = load_spacecraft(str(own)), load_spacecraft("free_flyer_payload")
    assert (found.sensors, found.momentum, found.known_bodies.mass) == ("testbed", "unknown", 0.02)
    made, expected = found.make(), shipped.make()
    assert made.mass == expected.mass > 0
    assert made.joint_names == expected.joint_names


def test_a_scenario_on_a_table_says_that_a_table_carries_the_spacecraft():
    assert load_spacecraft("air_bearing").planar is True
    assert load_spacecraft("free_flyer_payload").planar is None


def test_a_model_is_found_beside_its_file(tmp_path):
    folder = tmp_path / "craft"
    folder.mkdir()
    urdf = models_directory() / "free_flyer/free_flyer.urdf"
    (folder / "own.urdf").write_text(urdf.read_text())
    text = FILE.format(models=".").replace("./free_flyer/free_flyer.urdf", "own.urdf")
    (folder / "craft.yaml").write_text(text)
    assert load_spacecraft(str(folder / "craft.yaml")).make().path == folder / "own.urdf"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("base: body", "bass: body", "bass"),
        ("momentum: unknown", "momentum: small", "momentum"),
        ("base: body", "base: ''", "base"),
    ],
)
def test_a_wrong_entry_is_named_with_its_file(tmp_path, old, new, message):
    own = tmp_path / "craft.yaml"
    own.write_text(FILE.format(models=models_directory()).replace(old, new))
    with pytest.raises(InputError, match=message) as error:
        load_spacecraft(str(own))
    assert "craft.yaml" in str(error.value)
