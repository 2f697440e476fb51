"""Paths and URIs of models: what is found, and what is refused in one line."""

import pytest

from cpid_drake import InputError
from cpid_drake.files.resources import (
    MODELS_PACKAGE,
    models_directory,
    package_folders,
    resolve_model,
)

SERVICER = "dual_arm_servicer/dual_arm_servicer.urdf"


def test_a_package_uri_and_a_path_lead_to_the_same_file():
    by_uri = resolve_model(f"package://{MODELS_PACKAGE}/{SERVICER}")
    assert by_uri == resolve_model(models_directory() / SERVICER)
    assert by_uri.is_absolute()


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("sub folder/mödel.urdf", "sub folder/mödel.urdf"),
        ("~/a.urdf", "a.urdf"),
        ("package://mine/a.urdf", "a.urdf"),
    ],
)
def test_a_file_is_found(name, place, tmp_path, monkeypatch):
    """From the working directory, in the home folder, in a package of the caller."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text("x")
    assert resolve_model(name, package_folders({"mine": tmp_path})) == tmp_path / place


@pytest.mark.parametrize(
    ("uri", "cause"),
    [
        ("nowhere.urdf", "no such file"),
        ("", "a folder"),
        ("package://nobody/a.urdf", f"unknown package 'nobody'.*{MODELS_PACKAGE}"),
        (f"package://{MODELS_PACKAGE}/nowhere.urdf", "no such file"),
        ("https://example.org/a.urdf", "package:// URI, not https://"),
        ("nul\0byte.urdf", "no such file"),
        ("x" * 5000, "too long"),
        ("~nobody-of-this-name/a.urdf", "nobody-of-this-name"),
    ],
)
def test_what_is_no_file_is_refused_with_the_cause(uri, cause):
    with pytest.raises(InputError, match=cause):
        resolve_model(uri)


@pytest.mark.parametrize(
    ("name", "folder", "cause"),
    [("mine", "nowhere", "'mine'.*no such folder"), (MODELS_PACKAGE, ".", "already known")],
)
def test_a_package_that_cannot_be_is_refused(name, folder, cause, tmp_path):
    with pytest.raises(InputError, match=cause):
        package_folders({name: tmp_path / folder})
