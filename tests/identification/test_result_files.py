"""Result files: what is written is read back, and a file that is wrong anywhere is refused."""

import json
from dataclasses import asdict, fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cpid_drake import InputError
from cpid_drake.identification.budget import BudgetRow
from cpid_drake.identification.checks import Check
from cpid_drake.identification.effect_estimates import EffectEstimate
from cpid_drake.identification.request import Request, Source
from cpid_drake.identification.result import FORMAT, Combinations, Identification
from cpid_drake.identification.result_files import read_result, write_result
from cpid_drake.spacecraft.reference import SpacecraftReference


@pytest.fixture
def result(skewed_target) -> Identification:
    """Return a result with a value in every branch of the tree."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(10, 10))
    true = skewed_target.to_vector()
    half = np.array([-1.0, 2.0])
    unknown = np.where(np.arange(10) == 4, np.nan, true)
    delay = EffectEstimate(
        "gyro.delay",
        "ms",
        np.array([5.0]),
        np.array([0.1]),
        20.0,
        "log.csv",
    )
    row = BudgetRow("zero of elbow", np.full(10, 0.2), "mrad", 0.1, 0.5, 0.3)
    alone = Identification(
        parameters=unknown,
        covariance=np.eye(10),
        intervals=unknown[:, None] + half,
        rank=9,
        singular_values=np.ones(10),
        sample_count=20,
        estimator="least_squares",
        checks=(Check.of("agreement", "it differs", 3.0, 2.0),),
    )
    craft = SpacecraftReference(
        "package://mine/mine.urdf", "bus", "arm::gripper", {"mine": "/models"}
    )
    request = Request(
        "log.csv",
        craft,
        estimator="least_squares",
        momentum="unknown",
        end=30.0,
        topics={"imu": "/imu"},
        leave_out_bad=True,
        prior="prior.yaml",
    )
    return Identification(
        parameters=true + 1e-3 * rng.normal(size=10),
        covariance=root @ root.T,
        intervals=true[:, None] + half,
        rank=10,
        singular_values=np.sort(rng.uniform(size=10))[::-1],
        condition=29.4,
        not_identifiable="Ixx",
        nearest=true,
        consistent_intervals=unknown[:, None] + half,
        combinations=Combinations("relative", true, root @ root.T, 200.0),
        sample_count=20,
        rejected={"gyro": 1},
        estimator="least_squares",
        rows="standard",
        momentum="unknown",
        momentum_estimate=true[:3],
        momentum_covariance=np.eye(3),
        momentum_changes=(1.5, 2.25),
        noise={"gyro": 1.5},
        effects=(delay,),
        given=("spacecraft model",),
        budget=(row,),
        is_planar=True,
        normal_C=np.array([0.0, 0.0, 1.0]),
        logs={"log.csv": alone, "the prior": alone},
        checks=(
            Check("misfit", "the fit misses the samples", 4.0, 3.0),
            Check.of("noise", "the noise is larger", 1.0, 3.0),
        ),
        warnings=("σ of Ixx is large",),
        sources=(Source(request, {"telemetry": "ab12", "prior": None}, 1.5, 20.25, "0.1.0"),),
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


def test_no_branch_of_the_tree_is_left_out_of_this_test(result):
    in_memory = ("form", "solution", "sensors", "residuals", "history")
    values = [getattr(result, key.name) for key in fields(result) if key.name not in in_memory]
    assert all(isinstance(value, np.ndarray) or value not in (None, (), "", {}) for value in values)


def test_details_may_be_left_out(document, result, tmp_path):
    """A file of another program: the result has no more than the file."""
    bare = {key: document[key] for key in (*REQUIRED, "format")}
    (tmp_path / "r.json").write_text(json.dumps(bare))
    bare = read_result(tmp_path / "r.json")
    assert (bare.sources, bare.spacecraft, bare.consistent) == ((), None, None)
    assert bare.rejected == {}
    np.testing.assert_array_equal(bare.parameters, result.parameters)


# -- wrong files ---------------------------------------------------------------------------------


REQUIRED = (
    *("parameters", "covariance", "intervals", "rank", "singular_values", "sample_count"),
    "estimator",
)


@pytest.mark.parametrize("version", [None, FORMAT - 1])
def test_a_file_of_another_version_is_refused_in_one_line(refusal, document, version):
    document["format"] = version
    said = refusal(document)
    assert said.startswith("not a result of this version of cpid-drake")
    assert said.endswith("identify from the log again")
    del document["format"]
    assert refusal(document) == said


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
