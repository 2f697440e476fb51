"""Any bytes, and any small damage to a good file: an error with one line, or what the file says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from corpus import TARGET, link, npz, parquet, scenario, urdf, write_good
from corpus import csv as good_csv
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, Log, Spacecraft, load_scenario
from cpid_drake.identification.estimators import ESTIMATORS
from cpid_drake.identification.identify import identify
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.files import (
    inspect_telemetry,
    read_telemetry,
)
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import SENSORS


def few(count: int):
    """Return settings: so many examples, always the same, a folder shared by all of them."""
    return settings(
        max_examples=count,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def refused_or(read, path: Path):
    """Return what a file holds, or None if it is refused with one line that names it."""
    try:
        return read(path)
    except InputError as error:
        message = str(error)
        assert path.name in message
        assert message == " ".join(message.split())
        assert len(message) < 1000 + len(str(path))
        return None


def read_fully(path: Path) -> Log:
    """Read telemetry, and look at all of it."""
    found = inspect_telemetry(path)
    for name in SENSORS:
        samples = getattr(found.log, name)
        assert np.isfinite(samples.time).all()
        assert (np.diff(samples.time) > 0).all()
        # A wheel may have a rate and no angle.
        assert (np.isfinite(samples.value) | np.isnan(samples.value).all(axis=0)).all()
    check_conventions(found.log, None)
    return found.log


# -- damage ---------------------------------------------------------------------------------------


@st.composite
def damaged(draw, data: bytes) -> bytes:
    """Bytes flipped, taken out, repeated or put in; a piece cut off."""
    found = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(found) - 1, 0)))
        size = draw(st.integers(1, 60))
        match draw(st.sampled_from(["flip", "drop", "repeat", "insert", "cut"])):
            case "flip":
                found[at : at + 1] = bytes([draw(st.integers(0, 255))])
            case "drop":
                del found[at : at + size]
            case "repeat":
                found[at:at] = found[at : at + size]
            case "insert":
                found[at:at] = draw(st.binary(min_size=1, max_size=20))
            case "cut":
                del found[len(found) - at :]
    return bytes(found)


SHORT_CSV = "\n".join(good_csv().splitlines()[:12]) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("any")
    write_good(path)
    return path


@pytest.fixture(scope="module")
def craft(folder) -> Spacecraft:
    return Spacecraft(folder / "arm.urdf", base="bus", capture_frame="hand")


@pytest.fixture(scope="module")
def log(folder) -> Log:
    return read_telemetry(folder / "log.csv")


@few(40)
@given(content=st.binary(max_size=200))
@pytest.mark.parametrize("ending", ["csv", "npz", "db3", "mcap"])
def test_any_bytes_as_telemetry(folder, ending, content):
    path = folder / f"bytes.{ending}"
    path.write_bytes(content)
    refused_or(read_fully, path)


@few(80)
@given(content=damaged(SHORT_CSV.encode()))
def test_a_damaged_table(folder, content):
    path = folder / "damaged.csv"
    path.write_bytes(content)
    refused_or(read_fully, path)


@pytest.mark.parametrize(("ending", "make"), [("npz", npz()), ("parquet", parquet())])
def test_damaged_arrays(folder, ending, make):
    data, path = make(), folder / f"damaged.{ending}"

    @few(40)
    @given(content=damaged(data))
    def check(content):
        path.write_bytes(content)
        refused_or(read_fully, path)

    check()


@few(20)
@given(content=damaged(scenario()().encode()))
def test_a_damaged_scenario(folder, content):
    path = folder / "damaged.yaml"
    path.write_bytes(content)
    refused_or(load_scenario, path)


@few(50)
@given(content=damaged(urdf().encode()))
def test_a_damaged_model(folder, content):
    path = folder / "damaged.urdf"
    path.write_bytes(content)
    refused_or(lambda model: Spacecraft(model, base="bus", capture_frame="hand"), path)


def test_a_targets_looks_are_looked_into_as_well(folder, craft):
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    path = folder / "looks.urdf"
    path.write_text(urdf(link("hand", "1,5")))
    with pytest.raises(InputError, match=r"looks\.urdf: line 5: "):
        craft.add_to(plant, TARGET, scene_graph=scene_graph, target_visual_model=path)


def test_what_no_estimator_can_calculate_with_is_refused(craft, log, monkeypatch):
    def fail(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    failing = replace(ESTIMATORS["least_squares"], estimate=fail)
    monkeypatch.setitem(ESTIMATORS, "least_squares", failing)
    with pytest.raises(InputError, match="least_squares cannot calculate with these samples"):
        identify(craft, log)


# -- what must not matter -------------------------------------------------------------------------


@few(2)
@given(
    order=st.permutations(range(3)),
    shift=st.floats(-1e5, 1e5),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    move=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
)
@pytest.mark.parametrize("rows", ["standard", "relative", "eq18"])
def test_names_clocks_and_worlds_do_not_change_the_target(
    craft, log, rows, order, shift, turn, move
):
    """Columns in another order, another zero of time, another origin and other axes of W."""
    R_VW = Rotation.from_rotvec(turn)

    def moved(name: str, value: np.ndarray) -> np.ndarray:
        if name == "attitude":
            R_WB = Rotation.from_quat(value, scalar_first=True)
            return (R_VW * R_WB).as_quat(scalar_first=True)
        if name == "position":
            return R_VW.apply(value) + move
        if name == "velocity":
            return R_VW.apply(value)
        return value if name == "gyro" else value[:, list(order)]

    samples = {name: getattr(log, name) for name in SENSORS}
    other = replace(
        log,
        joint_names=tuple(log.joint_names[k] for k in order),
        **{name: Samples(s.time + shift, moved(name, s.value)) for name, s in samples.items()},
    )
    plain, again = (identify(craft, each, rows=rows) for each in (log, other))
    expected = TARGET.to_vector()
    np.testing.assert_allclose(plain.parameters, expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(again.parameters, expected, rtol=0, atol=1e-7)
