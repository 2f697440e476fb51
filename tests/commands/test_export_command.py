"""`cpid export`: from a result file to a model, and one line where there is none to be had."""

import json

import numpy as np
import pytest

from cpid_drake import InertialParameters, Spacecraft
from cpid_drake.files.resources import models_directory
from cpid_drake.identification.request import Request, Source
from cpid_drake.identification.result import Identification
from cpid_drake.identification.result_files import write_result
from cpid_drake.spacecraft.reference import SpacecraftReference

MODEL = models_directory() / "dual_arm_servicer" / "dual_arm_servicer.urdf"
ESTIMATE = np.array([60.001, 0.5, -0.12, 0.08, 8.0, 11.0, 6.0, -0.7, 0.4, 0.9])


@pytest.fixture
def result(skewed_target, tmp_path):
    """Return a function that writes `r.json`, with some keys changed."""

    craft = SpacecraftReference(str(MODEL), "bus", "capture_point")

    def write(**changes):
        found = Identification(
            parameters=ESTIMATE,
            covariance=np.eye(10),
            intervals=ESTIMATE[:, None] + np.array([-1.96, 1.96]),
            nearest=skewed_target.to_vector(),
            rank=10,
            singular_values=np.ones(10),
            sample_count=20,
            estimator="least_squares",
            rows="standard",
            sources=(Source(Request("log.csv", craft), {}, 0.0, 1.0, ""),),
        )
        write_result(tmp_path / "r.json", found)
        document = json.loads((tmp_path / "r.json").read_text()) | changes
        (tmp_path / "r.json").write_text(json.dumps(document))

    write()
    return write


def target_in(path, name="target") -> np.ndarray:
    joined = Spacecraft(path, base="bus", capture_frame="capture_point")
    inertia = joined.plant.GetBodyByName(name).default_spatial_inertia()
    return InertialParameters.from_spatial_inertia(inertia).to_vector()


def test_the_consistent_target_alone(cpid, result, tmp_path):
    code, stdout, stderr = cpid(
        "export", "r.json", "--format", "urdf", "--out", "t.urdf", "--name", "debris"
    )
    assert (code, stdout) == (0, "")
    assert stderr == "t.urdf: written; Drake reads the same parameters from it\n"
    text = (tmp_path / "t.urdf").read_text()
    assert '<link name="debris">' in text
    assert '<mass value="60.0"' in text


def test_failed_checks_are_allowed_by_an_option_of_their_own(cpid, result, refusal):
    """Leave to replace a file is no leave to export an answer that is not trustworthy."""
    result(checks=[{"name": "misfit", "sentence": "the residuals are too large"}])
    options = ("export", "r.json", "--format", "urdf", "--out", "t.urdf")
    for force in ((), ("--force",)):
        assert "--allow-failed-checks exports it all the same" in refusal(*options, *force)
    assert cpid(*options, "--allow-failed-checks")[0] == 0
    assert "exists" in refusal(*options, "--allow-failed-checks")
    assert cpid(*options, "--allow-failed-checks", "--force")[0] == 0


def test_the_estimate_as_it_is_on_the_spacecraft(cpid, result, tmp_path):
    """Again with --force; what is exported then still has its own spacecraft under it."""
    options = ("--format", "urdf", "--with-spacecraft", "--raw")
    code, _, stderr = cpid("export", "r.json", *options, "--out", "whole.urdf")
    assert (code, stderr) == (0, "whole.urdf: written; Drake reads the same parameters from it\n")
    np.testing.assert_allclose(target_in("whole.urdf"), ESTIMATE, rtol=1e-12)
    craft = {"model": "whole.urdf", "base": "bus", "capture_frame": "capture_point"}
    request = {"telemetry": "log.csv", "spacecraft": craft}
    source = {"request": request, "sha256": {}, "start": 0.0, "end": 1.0, "cpid_drake": ""}
    result(sources=[source])
    (tmp_path / "two.urdf").write_text("mine")
    code, _, stderr = cpid("export", "r.json", *options, "--out", "two.urdf", "--force")
    assert code == 0
    assert "the exported one is 'target_2'" in stderr
    for name in ("target", "target_2"):
        np.testing.assert_allclose(target_in("two.urdf", name), ESTIMATE, rtol=1e-12)


def test_what_cannot_be_a_rigid_body_is_not_exported(cpid, refusal, result):
    options = ("export", "r.json", "--format", "urdf", "--out", "t.urdf")
    result(nearest=None, parameters=[*ESTIMATE[:6], None, 0, 0, None], rank=8)
    for raw in ((), ("--raw",)):
        assert "20 samples determine 8 of 10" in refusal(*options, *raw)
    result(parameters=[*ESTIMATE[:4], 8, 15, 6, 0, 0, 0])
    assert "violate the triangle inequality" in refusal(*options, "--raw")
    assert cpid(*options)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("r.json", "--format", "obj", "--out", "t.urdf"),
            '"obj" for --format. Choose from: "urdf"',
        ),
        (("r.json", "--format", "sdf", "--out", "t.urdf"), "must end in .sdf"),
        (("r.json", "--format", "urdf", "--out", "old.urdf"), "old.urdf: exists already"),
        (("r.json", "--format", "urdf", "--out", "t.urdf", "--name", "<"), "cannot be used"),
    ],
)
def test_what_cannot_be_is_one_line(refusal, result, arguments, words, tmp_path):
    (tmp_path / "old.urdf").write_text("mine")
    assert words in refusal("export", *arguments)
    assert (tmp_path / "old.urdf").read_text() == "mine"
