"""No output destroys an input or a file that exists, whatever its name."""

import os

import pytest

from cpid_drake import InputError
from cpid_drake.files.overwriting import check_folder, check_outputs


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("time,qx\n")
    return tmp_path


def refusal(path, *inputs, force=False) -> str:
    with pytest.raises(InputError) as caught:
        check_outputs([("--out", path)], inputs, force=force)
    return str(caught.value)


@pytest.mark.parametrize(
    "name", ["log.csv", "./x/../log.csv", "soft.json", "hard.json", "soft/log.csv"]
)
def test_an_input_is_never_an_output(name, folder):
    (folder / "x").mkdir()
    if name == "soft/log.csv":
        (folder / "soft").symlink_to(".")
    elif name == "soft.json":
        (folder / "soft.json").symlink_to("log.csv")
    elif name == "hard.json":
        os.link("log.csv", "hard.json")
    assert "is the input" in refusal(folder / name, folder / "log.csv", force=True)


def test_files_of_a_bag_are_inputs_but_a_page_beside_them_is_not(folder):
    bag = folder / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("a: 1")
    (bag / "page.html").write_text("<!DOCTYPE html>")
    assert "is the input" in refusal(bag / "metadata.yaml", bag, force=True)
    check_outputs([("--out", bag / "page.html")], [bag], force=True)


def test_two_outputs_are_two_files(folder):
    with pytest.raises(InputError, match="two outputs cannot be the same file"):
        check_outputs([("--json", folder / "a"), ("--report", folder / "a")], force=True)


def test_a_file_that_exists_is_replaced_by_force_only(folder):
    (folder / "r.html").write_text("old")
    assert "exists already" in refusal(folder / "r.html")
    check_outputs([("--out", folder / "r.html"), ("--json", folder / "r.json")], force=True)
    assert (folder / "r.html").read_text() == "old"
    check_folder("--out", folder / "new" / "deep", names=["scenario.yaml"])
    assert not (folder / "new").exists()
    (folder / "scenario.yaml").write_text("a: 1")
    with pytest.raises(InputError, match=r"scenario\.yaml: exists already"):
        check_folder("--out", folder, names=["scenario.yaml"])
    with pytest.raises(InputError, match=r"scenario\.yaml: is the input"):
        check_folder("--out", folder, ["scenario.yaml"], names=["scenario.yaml"], force=True)


def test_places_that_cannot_be_written(folder):
    os.mkfifo("pipe")
    assert "a device or a pipe" in refusal(folder / "pipe", force=True)
    assert "is a folder" in refusal(folder, force=True)
    assert "there is no folder" in refusal(folder / "no" / "r.html", force=True)
    assert "there is no folder" in refusal(folder / "log.csv" / "r.html", force=True)
    assert "cannot write there" in refusal(folder / ("x" * 300 + ".html"))
    with pytest.raises(InputError, match="cannot write there"):
        check_folder("--out", folder / "log.csv" / "x", names=[])
