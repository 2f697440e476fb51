"""Any bytes, and any small damage to a good file: an error with one line, or what the file says."""

from pathlib import Path

import numpy as np
import pytest
from corpus import TARGET, link, parquet, scenario, urdf, write_good
from corpus import csv as good_csv
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake import InputError, Log, Spacecraft, load_scenario
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.formats import (
    inspect_log,
)
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
    found = inspect_log(path)
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


def as_model(path: Path) -> Spacecraft:
    return Spacecraft(path, base="bus", capture_frame="hand")


@pytest.mark.parametrize(
    ("name", "make", "read", "count"),
    [
        ("damaged.csv", lambda: SHORT_CSV.encode(), read_fully, 80),
        ("damaged.parquet", parquet(), read_fully, 40),
        ("damaged.mcap", lambda: b"no bag", read_fully, 20),
        ("damaged.yaml", lambda: scenario()().encode(), load_scenario, 20),
        ("damaged.urdf", lambda: urdf().encode(), as_model, 50),
    ],
)
def test_a_damaged_file_is_refused_or_read(folder, name, make, read, count):
    @few(count)
    @given(content=damaged(make()))
    def check(content):
        (folder / name).write_bytes(content)
        refused_or(read, folder / name)

    check()


def test_a_targets_looks_are_looked_into_as_well(folder):
    plant, scene_graph = MultibodyPlant(time_step=0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    path = folder / "looks.urdf"
    path.write_text(urdf(link("hand", "1,5")))
    with pytest.raises(InputError, match=r"looks\.urdf: line 5: "):
        as_model(folder / "arm.urdf").add_to(
            plant, TARGET, scene_graph=scene_graph, target_visual_model=path
        )
