"""Paths and URIs of models: what is found, and what is refused in one line."""

import pytest

from cpid_drake import InputError
from cpid_drake.resources import MODELS_PACKAGE, models_directory, package_folders, resolve_model

SERVICER = "dual_arm_servicer/dual_arm_servicer.urdf"


def refusal(call, *args) -> str:
    with pytest.raises(InputError) as caught:
        call(*args)
    message = str(caught.value)
    assert message
    assert "\n" not in message
    return message


def test_the_models_folder_holds_the_ros_package():
    folder = models_directory()
    assert f"<name>{MODELS_PACKAGE}</name>" in (folder / "package.xml").read_text()
    assert (folder / SERVICER).is_file()


def test_a_package_uri_and_a_path_lead_to_the_same_file():
    by_uri = resolve_model(f"package://{MODELS_PACKAGE}/{SERVICER}")
    assert by_uri == resolve_model(models_directory() / SERVICER)
    assert by_uri.is_absolute()


def test_a_relative_path_is_relative_to_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "mödel.urdf").write_text("x")
    monkeypatch.chdir(tmp_path)
    assert resolve_model("sub folder/mödel.urdf") == tmp_path / "sub folder" / "mödel.urdf"


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "a.urdf").write_text("x")
    assert resolve_model("~/a.urdf") == tmp_path / "a.urdf"


def test_packages_of_the_caller_are_found(tmp_path):
    (tmp_path / "a.urdf").write_text("x")
    packages = package_folders({"mine": tmp_path})
    assert resolve_model("package://mine/a.urdf", packages) == tmp_path / "a.urdf"


@pytest.mark.parametrize(
    ("uri", "cause"),
    [
        ("nowhere.urdf", "no such file"),
        ("", "a folder"),
        ("package://nobody/a.urdf", "unknown package 'nobody'"),
        ("package://", "unknown package ''"),
        (f"package://{MODELS_PACKAGE}/nowhere.urdf", "no such file"),
        (f"package://{MODELS_PACKAGE}", "a folder"),
        ("https://example.org/a.urdf", "package:// URI, not https://"),
        ("file:///a.urdf", "package:// URI, not file://"),
        ("://", "not ://"),
        ("nul\0byte.urdf", "no such file"),
        ("x" * 5000, ""),
        ("~nobody-of-this-name/a.urdf", ""),
    ],
)
def test_what_is_no_file_is_refused_with_the_cause(uri, cause):
    assert cause in refusal(resolve_model, uri)


def test_a_folder_is_no_model(tmp_path):
    message = refusal(resolve_model, tmp_path)
    assert "a folder" in message
    assert str(tmp_path) in message


def test_an_unknown_package_is_answered_with_the_known_ones():
    assert MODELS_PACKAGE in refusal(resolve_model, "package://nobody/a.urdf")


def test_a_package_whose_folder_does_not_exist_is_refused(tmp_path):
    message = refusal(package_folders, {"mine": tmp_path / "nowhere"})
    assert "'mine'" in message
    assert "no such folder" in message


def test_a_package_name_that_is_taken_is_refused(tmp_path):
    message = refusal(package_folders, {MODELS_PACKAGE: tmp_path})
    assert "already known" in message
