"""Writes files whole: each is written as a draft beside its place, and moved there at the end.

A process that is killed, a full disk or an exception leaves the file that was there before. Only a
killed process leaves its draft, in a hidden folder whose name starts with `.cpid-draft`.
"""

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from cpid_drake.files.errors import InputError

DRAFT = ".cpid-draft-"
"""Beginning of the names of the folders of drafts."""


@contextmanager
def draft_of(path: str | Path) -> Iterator[Path]:
    """Provide the path of a draft, alone in its folder; move the draft to `path` at the end.

    The draft has the same name. If `path` is a link, the file that it refers to is replaced. An
    exception inside removes the draft.

    Raises:
        InputError: the file cannot be written.

    """
    with write_errors(path):
        place = Path(os.path.realpath(path))
        if place.exists() and not os.access(place, os.W_OK):
            raise PermissionError(0, "the file is read-only")
        with TemporaryDirectory(prefix=DRAFT, dir=place.parent) as beside:
            draft = Path(beside, place.name)
            yield draft
            if place.exists():
                shutil.copymode(place, draft)
            with draft.open("rb") as file:  # on the disk before it has its name
                os.fsync(file.fileno())
            draft.replace(place)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file whole, in UTF-8.

    Raises:
        InputError: the file cannot be written.

    """
    with draft_of(path) as draft:
        draft.write_text(text, encoding="utf-8")


@contextmanager
def draft_folder(folder: str | Path, names: Sequence[str] = ()) -> Iterator[Path]:
    """Provide an empty folder for files that belong together; move them into `folder` at the end.

    A new folder appears with all its files. From a folder that exists, earlier files are removed
    before the first new one is moved: files of two runs are never side by side. Other files stay.

    Args:
        folder: the place; its parents are created.
        names: names of earlier files, besides those of the new ones. The last one shows that the
            folder is whole: it is removed first, and moved last.

    Raises:
        InputError: a file cannot be written; the earlier files are then unchanged.

    """
    with write_errors(folder):
        place = Path(os.path.realpath(folder))
        place.parent.mkdir(parents=True, exist_ok=True)
        home = place if place.is_dir() else place.parent  # on the same disk as the files' places
        with TemporaryDirectory(prefix=DRAFT, dir=home) as beside:
            draft = Path(beside, place.name)
            draft.mkdir()
            try:
                yield draft
            except InputError as error:  # a file in the draft could not be written
                raise InputError(str(error).replace(str(draft), str(folder))) from error
            if not place.exists():
                draft.replace(place)
                return
            every = {*names, *(file.name for file in draft.iterdir())}
            order = sorted(every, key=lambda name: (name in names[-1:], name))
            for name in order:
                if (place / name).is_dir():
                    raise IsADirectoryError(0, f"{name} is a folder")
            for name in reversed(order):
                (place / name).unlink(missing_ok=True)
            for file in (draft / name for name in order):
                if file.exists():
                    file.replace(place / file.name)


@contextmanager
def write_errors(where: str | Path) -> Iterator[None]:
    """Turn an operating system's error inside into an InputError that names the place."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{where!s:.200}: cannot write there: {error.strerror or error}"
        ) from error
