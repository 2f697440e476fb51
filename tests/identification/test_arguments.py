"""`identify` and `validate` accept the names and paths of the command line, and refuse the rest."""

import numpy as np
import pytest
from flyer_cases import MASS, columns, csv_of, flyer, write

from cpid_drake import (
    InputError,
    MomentumIdentifier,
    OnlineIdentifier,
    SensorIdentifier,
    SpacecraftSensors,
    identify,
    load_sensors,
    read_log,
    validate,
)
from cpid_drake.dynamics.uncertainty import BodyUncertainty


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, csv_of(columns()))


def fit(data, **options):
    return identify(flyer(), data, rows="relative", **options)


def test_names_and_paths_are_read(path, tmp_path):
    bodies = write(tmp_path, "mass: 0.02\n", "bodies.yaml")
    by_name = identify(
        flyer(), str(path), sensors="testbed", momentum="zero", known_bodies="mass=0.02"
    )
    by_object = identify(
        flyer(),
        read_log(path),
        sensors=load_sensors("testbed"),
        momentum="zero",
        known_bodies=BodyUncertainty(mass=0.02),
    )
    np.testing.assert_array_equal(by_name.parameters, by_object.parameters)
    assert abs(by_name["m"].value - MASS) < 4 * by_name["m"].sigma
    assert fit(path, known_bodies=bodies).warnings == fit(path, known_bodies="mass=0.02").warnings


def test_several_paths_are_several_logs(path, tmp_path):
    given = columns()
    paths = [path, write(tmp_path, csv_of({n: c[50:] for n, c in given.items()}), "second.csv")]
    found = fit(paths)
    assert {*found.logs} == {*map(str, paths)}
    np.testing.assert_array_equal(found.parameters, fit({str(p): p for p in paths}).parameters)


WRONG = {
    "path of a model": ({"spacecraft": "craft.urdf"}, r"give Spacecraft\('craft.urdf', base="),
    "no spacecraft": ({"spacecraft": None}, "must be a Spacecraft, not None: a model alone"),
    "no such log": ({"data": "nowhere.csv"}, "nowhere.csv: no such file"),
    "no log": ({"data": []}, "there is no log"),
    "an array": ({"data": np.zeros((9, 9))}, "path of a log, not ndarray: `from_columns`"),
    "nothing of a name": ({"data": {"first": None}}, "'first' must be a Log.*not NoneType"),
    "no such preset": ({"sensors": "magic"}, "choose from air_bearing.*or give a file"),
    "no such momentum": ({"momentum": "none"}, "no momentum 'none'; choose from zero, unknown"),
    "a vector": ({"momentum": np.zeros(3)}, "momentum must be a TotalMomentum, zero, or unknown"),
    "a number": ({"known_bodies": 0.01}, "known_bodies must be a BodyUncertainty, a text"),
    "a mass": ({"prior": 8.5}, "prior must be a TargetPrior, a result, or a file, not 8.5"),
    "a word": ({"planar": "yes"}, "planar must be a bool, or None, not 'yes'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_of_another_type_is_refused(path, name):
    options, phrase = WRONG[name]
    given = {"spacecraft": flyer(), "data": path} | options
    with pytest.raises(InputError, match=phrase):
        identify(given.pop("spacecraft"), given.pop("data"), **given)


def test_validate_reads_them_too(path, tmp_path):
    text = "mass: 8.5\nsigma_mass: 0.1\n"
    prior = write(tmp_path, text, "cad.yaml")
    found = validate(flyer(), prior, path, sensors="testbed", momentum="zero")
    assert found.is_target_right
    for target, options, phrase in [
        (None, {}, "no target to validate"),
        (8.5, {}, "prior must be a TargetPrior"),
        (prior, {"momentum": "none"}, "no momentum 'none'"),
        (prior, {"sensors": 5}, "sensors must be a SensorSuite"),
    ]:
        with pytest.raises(InputError, match=phrase):
            validate(flyer(), target, path, **options)


@pytest.mark.parametrize("system", [MomentumIdentifier, OnlineIdentifier, SensorIdentifier])
def test_systems_take_names_too_and_refuse_a_model(servicer, system):
    """As the command line does."""
    sensors = () if system is MomentumIdentifier else ("flight",)
    system(servicer, *sensors, momentum="unknown")
    with pytest.raises(InputError, match="momentum"):
        system(servicer, *sensors, momentum="large")
    with pytest.raises(InputError, match="must be a Spacecraft"):
        system("craft.urdf", *sensors)


@pytest.mark.parametrize("system", [OnlineIdentifier, SensorIdentifier, SpacecraftSensors])
def test_sensors_that_are_none_are_refused(servicer, system):
    with pytest.raises(InputError, match="no sensors"):
        system(servicer, "nothing.yaml")
    with pytest.raises(InputError, match="sensors must be"):
        system(servicer, 5)
