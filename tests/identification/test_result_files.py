"""Result files: what is written is read back, and a file that is wrong anywhere is refused."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cpid_drake import InputError
from cpid_drake.identification.result_files import (
    FeasibleEstimate,
    IdentificationResult,
    Source,
    SpacecraftReference,
    WhitenessRecord,
    read_result,
    write_result,
)


@pytest.fixture
def result(skewed_target) -> IdentificationResult:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(10, 10))
    true = skewed_target.to_vector()
    parameters = true + 1e-3 * rng.normal(size=10)
    return IdentificationResult(
        mass=parameters[0],
        com=parameters[1:4],
        inertia=parameters[4:],
        covariance=root @ root.T,
        feasible=FeasibleEstimate(true[0], true[1:4], true[4:]),
        rank=10,
        condition=29.4,
        samples_used=20,
        samples_rejected=1,
        warnings=["σ of Ixx is large"],
        estimator="least_squares",
        rows="standard",
        spacecraft=SpacecraftReference(
            "package://mine/mine.urdf", "bus", "arm::gripper", {"mine": "/models"}
        ),
        interval_95=skewed_target.to_vector()[:, None] + np.array([-1.0, 2.0]),
        infeasibilities=["the mass is not positive"],
        principal_moments=np.array([1.0, 2.0, 2.5]),
        principal_axes=np.linalg.qr(root[:3, :3])[0],
        not_observable="Ixx",
        singular_values=np.sort(rng.uniform(size=10))[::-1],
        residual_whiteness=WhitenessRecord(0.25, False, 3.5),
        samples_rejected_by_sensor={"gyro": 1},
        source=Source(
            telemetry="log.csv",
            sha256="ab12",
            sensors=None,
            momentum="unknown",
            topics={"imu": "/imu"},
            leave_out_bad=True,
            command="cpid identify log.csv",
            start=1.5,
            end=20.25,
            cpid_drake="0.1.0",
        ),
    )


@pytest.fixture
def document(result, tmp_path) -> dict:
    write_result(tmp_path / "right.json", result)
    return json.loads((tmp_path / "right.json").read_text())


@pytest.fixture
def refusal(tmp_path):
    """Return a function that reads a file with this content, and gives the error's message."""

    def read(content) -> str:
        path = tmp_path / "wrong.json"
        if isinstance(content, dict):
            content = json.dumps(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(InputError) as caught:
            read_result(path)
        message = str(caught.value)
        assert message.startswith(f"{path}: ")
        assert len(message) < len(str(path)) + 400
        return message.removeprefix(f"{path}: ")

    return read


def assert_same(one, other) -> None:
    np.testing.assert_equal(asdict(one), asdict(other))


# -- there and back ------------------------------------------------------------------------------


def test_what_is_written_is_read_back_to_the_last_digit(result, tmp_path):
    write_result(tmp_path / "r.json", result)
    assert_same(result, read_result(tmp_path / "r.json"))


DETAILS = (
    *("interval_95", "infeasibilities", "principal_moments", "principal_axes", "not_observable"),
    *("singular_values", "residual_whiteness", "samples_rejected_by_sensor", "source", "names"),
    "units",
)


def test_details_may_be_left_out(document, result, tmp_path):
    """A file of another program: the result has no more than the file."""
    for key in DETAILS:
        del document[key]
    (tmp_path / "r.json").write_text(json.dumps(document))
    bare = read_result(tmp_path / "r.json")
    assert bare.source is None
    assert bare.interval_95 is None
    assert bare.samples_rejected_by_sensor == {}
    np.testing.assert_array_equal(bare.parameters, result.parameters)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"covariance": np.eye(3)}, "covariance must be a list of 10x10 numbers"),
        ({"rank": 11}, "rank must be a whole number <= 10"),
        ({"estimator": None}, "estimator must be text"),
    ],
)
def test_a_result_that_could_not_be_read_is_not_written(result, change, words, tmp_path):
    with pytest.raises(InputError, match=words):
        write_result(tmp_path / "r.json", replace(result, **change))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named(result, tmp_path):
    with pytest.raises(InputError, match=r"no/r\.json: cannot write there: No such file"):
        write_result(tmp_path / "no" / "r.json", result)


# -- wrong files ---------------------------------------------------------------------------------


NAMES = {"model": "m", "base": "b", "capture_frame": "c"}
REQUIRED = (
    *("mass", "com", "inertia", "covariance", "feasible", "rank", "condition", "samples_used"),
    *("samples_rejected", "warnings", "estimator", "rows", "spacecraft"),
)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("mass", "100", "mass must be a number, not '100'"),
        ("com", [1, 2], "com must be a list of 3 numbers, not [1, 2]"),
        ("covariance", 10 * [9 * [0]], "covariance must be a list of 10x10 numbers"),
        ("rank", 11, "rank must be a whole number <= 10, not 11"),
        ("rank", True, "rank must be a whole number, not true"),
        ("samples_used", -1, "samples_used must be a whole number >= 0, not -1"),
        ("warnings", [1], "warnings[0] must be text, not 1"),
        ("estimator", "\ud800", "'\\ud800' is half of a character, which is not text"),
        ("spacecraft", {"model": "m"}, "spacecraft.base is missing"),
        ("spacecraft", NAMES | {"bas": "b"}, "unknown key 'spacecraft.bas'; did you mean 'base'?"),
        ("spacecraft", NAMES | {"packages": "p"}, "spacecraft.packages must be a mapping, not 'p'"),
        (
            "spacecraft",
            NAMES | {"packages": {"p": 1}},
            "spacecraft.packages.p must be text, not 1",
        ),
    ],
)
def test_a_value_of_another_kind_is_named(refusal, document, key, value, words):
    assert refusal({**document, key: value}).startswith(words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": None}, "feasible.mass must be a number, not null"),
        ({"mass": -1.0}, "feasible: no rigid body has these: the mass -1 kg is not positive"),
        ({"inertia": [1, 1, 3, 0, 0, 0]}, "feasible: no rigid body has these: principal moments"),
        ({"inertia": 6 * [1e308]}, "feasible: 1e+308 is too large for a rigid body"),
        ({"volume": 2}, "unknown key 'feasible.volume'"),
    ],
)
def test_feasible_must_be_what_it_says(refusal, document, change, words):
    document["feasible"] |= change
    assert refusal(document).startswith(words)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=11) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=12,
)


@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(key=st.sampled_from(REQUIRED), value=JSON)
def test_any_value_is_read_or_refused(document, tmp_path, key, value):
    path = tmp_path / "any.json"
    path.write_text(json.dumps({**document, key: value}))
    try:
        found = read_result(path)
    except InputError:
        return
    write_result(tmp_path / "again.json", found)
    assert_same(found, read_result(tmp_path / "again.json"))
