"""Writes files whole: each is written as a draft beside its place, and moved there at the end.

A process that is killed, a full disk or an exception leaves the file that was there before. Only a
killed process leaves its draft, a hidden file whose name starts with `.cpid-draft`.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from cpid_drake.files.errors import InputError

DRAFT = ".cpid-draft"
"""Beginning of the names of drafts."""

UNFINISHED = "UNFINISHED"
"""Name of the file in a folder whose files are not all from the same run."""


@contextmanager
def draft_of(path: str | Path) -> Iterator[Path]:
    """Provide the path of a draft to write; move the draft to `path` at the end.

    The draft has the same ending. If `path` is a link, the file that it refers to is replaced. An
    exception inside removes the draft.

    Raises:
        InputError: the file cannot be written.

    """
    with write_errors(path):
        place = Path(os.path.realpath(path))
        if place.exists() and not os.access(place, os.W_OK):
            raise PermissionError(0, "the file is read-only")
        draft = place.with_name(_draft_name(place.name))
        try:
            yield draft
            if place.exists():
                shutil.copymode(place, draft)
            with draft.open("rb") as file:  # on the disk before it has its name
                os.fsync(file.fileno())
            draft.replace(place)
        finally:
            draft.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole, in UTF-8.

    Raises:
        InputError: the file cannot be written.

    """
    with draft_of(path) as draft:
        draft.write_text(text, encoding="utf-8")


@contextmanager
def draft_folder(folder: str | Path, group: Sequence[str] = ()) -> Iterator[Path]:
    """Provide an empty folder for files that belong together; move them into `folder` at the end.

    A new folder appears with all its files. In a folder that exists, the files are moved one after
    the other; during these moves the folder holds the file `UNFINISHED`. Other files stay.

    Args:
        folder: the place; its parents are created.
        group: names of the files of a run. Those that are not written are removed from `folder`.

    Raises:
        InputError: a file cannot be written.

    """
    with write_errors(folder):
        place = Path(os.path.realpath(folder))
        place.parent.mkdir(parents=True, exist_ok=True)
        exists = place.is_dir()
        draft = (place if exists else place.parent) / _draft_name(place.name)
        draft.mkdir()
        try:
            yield draft
            if not exists:
                draft.replace(place)
                return
            files = sorted(draft.iterdir())
            for file in files:
                if (place / file.name).is_dir():
                    raise IsADirectoryError(0, f"{file.name} is a folder")
            write_text(place / UNFINISHED, "A command was stopped while it moved files of a run.\n")
            for name in {*group} - {file.name for file in files}:
                (place / name).unlink(missing_ok=True)
            for file in files:
                file.replace(place / file.name)
            (place / UNFINISHED).unlink()
        except InputError as error:  # a file in the draft could not be written
            raise InputError(str(error).replace(str(draft), str(folder))) from error
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def refuse_unfinished(folder: str | Path) -> None:
    """Refuse a folder whose files are not all from the same run.

    Raises:
        InputError: `draft_folder` was stopped while it moved the files.

    """
    if Path(folder, UNFINISHED).exists():
        raise InputError(
            f"{folder}: unfinished: its files are from two runs, because a command was stopped "
            "while it wrote them; write the folder again"
        )


@contextmanager
def write_errors(where: str | Path) -> Iterator[None]:
    """Turn an operating system's error inside into an InputError that names the place."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{where!s:.200}: cannot write there: {error.strerror or error}"
        ) from error


def _draft_name(name: str) -> str:
    return f"{DRAFT}-{uuid4().hex[:12]}-{name[-40:]}"
