"""Files and folders are written whole or not at all."""

import os
import stat

import pytest

from cpid_drake import InputError
from cpid_drake.files.drafts import (
    UNFINISHED,
    draft_folder,
    draft_of,
    refuse_unfinished,
    write_text,
)

NAMES = ("a.csv", "b.json", "c.yaml")


def contents(folder) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


@pytest.mark.parametrize(
    "failure", [OSError(28, "No space left"), KeyboardInterrupt(), ValueError()]
)
def test_a_failure_leaves_the_old_file_and_no_draft(failure, tmp_path):
    (tmp_path / "page.html").write_text("old")

    def write():
        with draft_of(tmp_path / "page.html") as draft:
            draft.write_text("half of the n")
            raise failure

    with pytest.raises(InputError if isinstance(failure, OSError) else type(failure)):
        write()
    assert contents(tmp_path) == {"page.html": "old"}


def test_a_link_and_permissions_stay(tmp_path):
    (tmp_path / "target.json").write_text("old")
    (tmp_path / "link.json").symlink_to("target.json")
    (tmp_path / "target.json").chmod(0o600)
    write_text(tmp_path / "link.json", "new")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "target.json").read_text() == "new"
    assert stat.S_IMODE((tmp_path / "target.json").stat().st_mode) == 0o600


def test_a_read_only_file_is_not_replaced(tmp_path, monkeypatch):
    if os.geteuid() == 0:  # may write all files: answer as for the owner, by the permissions
        monkeypatch.setattr(os, "access", lambda path, mode: path.stat().st_mode >> 6 & mode)
    (tmp_path / "r.json").write_text("old")
    (tmp_path / "r.json").chmod(0o400)
    with pytest.raises(InputError, match="read-only"):
        write_text(tmp_path / "r.json", "new")
    assert contents(tmp_path) == {"r.json": "old"}
    (tmp_path / "r.json").chmod(0o600)
    write_text(tmp_path / "r.json", "new")
    assert contents(tmp_path) == {"r.json": "new"}


def test_a_new_folder_appears_with_all_its_files(tmp_path):
    with draft_folder(tmp_path / "deep" / "run") as draft:
        for name in NAMES:
            (draft / name).write_text("new")
        assert not (tmp_path / "deep" / "run").exists()
    assert contents(tmp_path / "deep" / "run") == dict.fromkeys(NAMES, "new")
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["run"]


def test_a_folder_keeps_other_files_and_loses_those_of_the_earlier_run(tmp_path):
    for name in (*NAMES, "mine.txt"):
        (tmp_path / name).write_text("old")
    with draft_folder(tmp_path, NAMES) as draft:
        (draft / "a.csv").write_text("new")
        (draft / "b.json").write_text("new")
    assert contents(tmp_path) == {"a.csv": "new", "b.json": "new", "mine.txt": "old"}


@pytest.mark.parametrize("failing", range(6))
def test_a_folder_is_old_or_new_or_unfinished_at_every_instant(failing, tmp_path, monkeypatch):
    """A process that ends before any of the moves leaves no mixture that is not marked."""

    class Killed(BaseException):
        """The process ends here."""

    for name in NAMES:
        (tmp_path / name).write_text("old")
    moves, replace = [], type(tmp_path).replace

    def stop_after(path, target):
        if len(moves) == failing:
            raise Killed
        moves.append(target)
        return replace(path, target)

    def write():
        with draft_folder(tmp_path, NAMES) as draft:
            for name in NAMES:
                (draft / name).write_text("new")

    monkeypatch.setattr(type(tmp_path), "replace", stop_after)
    if failing < 4:  # the marker and three files
        with pytest.raises(Killed):
            write()
    else:
        write()
    is_marked = (tmp_path / UNFINISHED).exists()
    states = {(tmp_path / name).read_text() for name in NAMES}
    assert is_marked == (1 <= failing < 4)
    assert len(states) == 1 or is_marked
    if is_marked:
        with pytest.raises(InputError, match="unfinished"):
            refuse_unfinished(tmp_path)
    monkeypatch.undo()
    write()
    refuse_unfinished(tmp_path)
    assert contents(tmp_path) == dict.fromkeys(NAMES, "new")
