"""No output destroys an input or a file of another kind, whatever its name."""

import os

import pytest

from cpid_drake import InputError
from cpid_drake.output_files.overwriting import (
    CSV_LOG,
    MODEL,
    PAGE,
    RESULT,
    YAML,
    Output,
    check_folder,
    check_outputs,
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("time,qx\n")
    (tmp_path / "arm.urdf").write_text("<robot/>")
    return tmp_path


def refusal(kind, path, *inputs, force=False) -> str:
    with pytest.raises(InputError) as caught:
        check_outputs([Output("--out", path, kind)], inputs, force=force)
    return str(caught.value)


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    "name", ["log.csv", "./x/../log.csv", "soft.json", "hard.json", "soft/log.csv"]
)
def test_an_input_is_never_an_output(name, force, folder):
    (folder / "x").mkdir()
    if name == "soft/log.csv":
        (folder / "soft").symlink_to(".")
    elif name == "soft.json":
        (folder / "soft.json").symlink_to("log.csv")
    elif name == "hard.json":
        os.link("log.csv", "hard.json")
    message = refusal(RESULT, folder / name, folder / "log.csv", force=force)
    assert "is the input" in message
    assert "would be lost" in message


def test_files_of_a_bag_are_inputs_but_a_page_beside_them_is_not(folder):
    bag = folder / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("a: 1")
    (bag / "page.html").write_text("<!DOCTYPE html>")
    assert "is the input" in refusal(YAML, bag / "metadata.yaml", bag / "metadata.yaml", force=True)
    assert "is the input" in refusal(RESULT, bag / "metadata.yaml", bag, force=True)
    check_outputs([Output("--out", bag / "page.html", PAGE)], [bag])


def test_two_outputs_are_two_files(folder):
    outputs = [Output("--json", folder / "a", RESULT), Output("--report", folder / "a", PAGE)]
    with pytest.raises(InputError, match="two outputs cannot be the same file"):
        check_outputs(outputs, force=True)


@pytest.mark.parametrize(
    ("kind", "name", "text"),
    [
        (PAGE, "r.html", "<robot/>"),
        (RESULT, "r.json", "{}"),
        (RESULT, "r", "precious"),
        (CSV_LOG, "r.csv", "a,b\n"),
        (YAML, "r.yaml", "a: 1"),
        (MODEL, "r.urdf", "<robot/>"),
    ],
)
def test_a_file_is_replaced_only_by_its_like(kind, name, text, folder):
    (folder / name).write_text(text)
    assert "exists already" in refusal(kind, folder / name)
    check_outputs([Output("--out", folder / name, kind)], force=True)
    assert (folder / name).read_text() == text


@pytest.mark.parametrize("name", ["r.urdf", "r.csv", "r.json", "r.STL"])
def test_a_page_does_not_get_the_name_of_another_kind(name, folder):
    assert "end its name in .html" in refusal(PAGE, folder / name)
    check_outputs([Output("--out", folder / name, PAGE)], force=True)


def test_places_that_cannot_be_written(folder):
    os.mkfifo("pipe")
    assert "is a device or a pipe" in refusal(PAGE, folder / "pipe", force=True)
    assert "is a folder" in refusal(PAGE, folder, force=True)
    assert "there is no folder" in refusal(PAGE, folder / "no" / "r.html", force=True)
    assert "there is no folder" in refusal(PAGE, folder / "log.csv" / "r.html", force=True)
    assert "cannot write there" in refusal(PAGE, folder / ("x" * 300 + ".html"))


def test_a_folder_of_outputs_follows_the_same_rule(folder):
    check_folder("--out", folder / "new" / "deep", [("scenario.yaml", YAML)])
    assert not (folder / "new").exists()
    (folder / "scenario.yaml").write_text("a: 1")
    with pytest.raises(InputError, match=r"scenario\.yaml: exists already"):
        check_folder("--out", folder, [("scenario.yaml", YAML)])
    with pytest.raises(InputError, match=r"scenario\.yaml: is the input"):
        check_folder("--out", folder, [("scenario.yaml", YAML)], ["scenario.yaml"], force=True)
    with pytest.raises(InputError, match="cannot write there"):
        check_folder("--out", folder / "log.csv" / "x", [])
