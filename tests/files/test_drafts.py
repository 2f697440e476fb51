"""Files and folders are written whole or not at all."""

import os
import stat

import pytest
from processes import finish, start

from cpid_drake import InputError
from cpid_drake.files.drafts import draft_folder, draft_of, write_text

NAMES = ("b.csv", "c.yaml", "a.json")


def contents(folder, names="*") -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.glob(names)}


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
        (draft / "b.csv").write_text("new")
        (draft / "a.json").write_text("new")
    assert contents(tmp_path) == {"b.csv": "new", "a.json": "new", "mine.txt": "old"}


KILLED = """
import itertools, os, sys
from cpid_drake.files.drafts import draft_folder, draft_of

steps, changes = itertools.count(), ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir")

def end_before_one(event, arguments):
    if event in changes and next(steps) == int(sys.argv[1]):
        os._exit(9)

sys.addaudithook(end_before_one)
"""
FOLDER = """
with draft_folder("run", ("b.csv", "c.yaml", "a.json")) as draft:
    for name in ("b.csv", "a.json"):
        (draft / name).write_text("new")
"""
FILE = """
with draft_of("run/b.csv") as draft:
    draft.write_text("new")
"""
OLD = {**dict.fromkeys(NAMES, "old"), "mine.txt": "old"}
NEW = {"b.csv": "new", "a.json": "new"}


def states_after_kills(program, old, tmp_path):
    """Yield a folder's visible files after the end of a process before each of its changes.

    The last is that of a process that was not ended.
    """
    for step in range(100):
        place = tmp_path / str(step) / "run"
        (place if old else place.parent).mkdir(parents=True)
        for name, text in old.items():
            (place / name).write_text(text)
        ended = finish(start("-c", KILLED + program, step, cwd=place.parent))
        assert ended.returncode in (0, 9), ended.stderr
        yield contents(place, "[!.]*")
        if not ended.returncode:
            return


def test_a_killed_process_leaves_the_old_file_or_the_new_one(tmp_path):
    first, *states, last = states_after_kills(FILE, OLD, tmp_path)
    assert first == OLD
    assert last == OLD | {"b.csv": "new"}
    assert all(state in (first, last) for state in states)


def test_a_killed_process_leaves_no_new_folder_or_all_of_it(tmp_path):
    first, *states, last = states_after_kills(FOLDER, {}, tmp_path)
    assert (first, last) == ({}, NEW)
    assert all(state in (first, last) for state in states)


def test_a_killed_process_leaves_no_mixture_and_no_part_that_looks_whole(tmp_path):
    """The last of the names is there only if all are. The next process writes a whole folder."""
    *states, last = states_after_kills(FOLDER, OLD, tmp_path)
    assert last == NEW | {"mine.txt": "old"}
    assert len(states) > 6
    for state in states:
        assert state.pop("mine.txt") == "old"
        assert len({*state.values()}) <= 1
        assert "a.json" not in state or state in (NEW, dict.fromkeys(NAMES, "old"))
    for step in range(len(states)):
        with draft_folder(tmp_path / str(step) / "run", NAMES) as draft:
            (draft / "a.json").write_text("newer")
        found = contents(tmp_path / str(step) / "run", "[!.]*")
        assert found == {"a.json": "newer", "mine.txt": "old"}


def test_a_folder_that_cannot_be_written_keeps_its_files(tmp_path):
    """A new file has the name of a folder that is there."""
    for name in ("b.csv", "a.json"):
        (tmp_path / name).write_text("old")
    (tmp_path / "c.yaml").mkdir()

    def write():
        with draft_folder(tmp_path, NAMES) as draft:
            (draft / "c.yaml").write_text("new")

    with pytest.raises(InputError, match=r"c\.yaml is a folder"):
        write()
    (tmp_path / "c.yaml").rmdir()
    assert contents(tmp_path) == {"b.csv": "old", "a.json": "old"}


def test_a_file_that_cannot_be_written_in_a_folder_is_named_with_its_place(tmp_path):

    def write():
        with draft_folder(tmp_path / "run") as draft:
            write_text(draft / "deep" / "b.csv", "new")

    with pytest.raises(InputError, match=f"{tmp_path}/run/deep/b.csv: cannot write there"):
        write()
    assert contents(tmp_path) == {}
