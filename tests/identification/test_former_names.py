"""Former names of estimators: accepted in one version, with one warning each time."""

import warnings
from dataclasses import replace

import pytest

from cpid_drake import Spacecraft, identify, load_sensors, read_telemetry
from cpid_drake.identification.former_names import FormerNameWarning
from cpid_drake.identification.requests import Request, identify_file, request_of_result
from cpid_drake.identification.result_files import (
    SpacecraftReference,
    read_result,
    write_result,
)
from cpid_drake.resources import models_directory

SAMPLE = str(models_directory() / "telemetry/free_flyer.csv")
CRAFT = SpacecraftReference(
    str(models_directory() / "free_flyer/free_flyer.urdf"), "body", "capture_point"
)


def test_identify_accepts_a_former_name_with_one_warning_at_the_callers_line():
    spacecraft = Spacecraft(CRAFT.model, base=CRAFT.base, capture_frame=CRAFT.capture_frame)
    log = read_telemetry(SAMPLE)
    with pytest.warns(FormerNameWarning, match="is now named 'recursive_fit'") as found:
        result = identify(
            spacecraft, log, estimator="momentum_filter", sensors=load_sensors("testbed")
        )
    assert [each.filename for each in found] == [__file__]
    assert issubclass(FormerNameWarning, DeprecationWarning)
    assert result.estimator == "recursive_fit"
    assert result.is_observable


def test_a_result_file_of_an_earlier_version_is_read_and_repeated_without_a_warning(tmp_path):
    result = identify_file(Request(SAMPLE, CRAFT, rows="standard")).result
    write_result(tmp_path / "old.json", replace(result, estimator="momentum_filter", rows=None))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = read_result(tmp_path / "old.json")
        request = request_of_result(again, str(tmp_path / "old.json"))
    assert again.estimator == "momentum_filter"
    assert request.estimator == "recursive_fit"
