"""Copies of model files for Drake, without what it cannot read and the motion does not need."""

import re
import shutil
import weakref
from collections.abc import Mapping
from pathlib import Path
from tempfile import mkdtemp
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape

from cpid_drake.spacecraft.model_check import ONCE, may_matter
from cpid_drake.spacecraft.model_content import FileContent, ModelContent

_UNDEFINED = re.compile(r"XML Element\[([^]]+)\], child of element\[([^]]+)\], not defined in SDF")


def leave_out_undefined(content: ModelContent, message: str) -> bool:
    """Leave out elements that SDFormat does not define, and say whether there are such.

    Args:
        content: the files; those elements are left out of their copies, and counted.
        message: the message of Drake's that names them. Elements that may matter are not left out.

    """
    match = _UNDEFINED.search(message)
    if match is None:
        return False
    name, parent = match.groups()
    undefined = {
        element: file
        for file in content.files.values()
        for outer in (file.xml.places if file.xml is not None and file.ending == ".sdf" else ())
        for element in outer
        if (outer.tag, element.tag) == (parent, name) and element not in file.whole
    }
    if not undefined or any(may_matter(element, ONCE) for element in undefined):
        return False
    for element, file in undefined.items():
        file.whole[element] = ""
    content.unread[name] += len(undefined)
    return True


class ModelCopies:
    """The files of a model as Drake reads them: copies of those that are changed.

    A file that includes a changed one is copied, too. What a copy refers to is where it was.

    Args:
        content: the files and their changes.
        path: the model's first file.

    Attributes:
        path: the file for Drake.
        originals: the file of each copy.

    """

    def __init__(self, content: ModelContent, path: Path) -> None:
        self._files, self._folder = content.files, ""
        self.originals, self._copies = dict[Path, Path](), dict[Path, Path]()
        # The paths in all MJCF files start at the folder of the first.
        self._changed = {f.main for f in content.files.values() if f.whole or f.heads}
        self.path = self._copy_of(path)

    def original_names(self, text: str) -> str:
        """Return a text with the names of the files in place of those of their copies."""
        for copy, original in self.originals.items():
            text = text.replace(str(copy), str(original))
        return text

    def _copy_of(self, path: Path) -> Path:
        """Return the path of a file's copy, or its own path if nothing of it is changed."""
        if path in self._copies:
            return self._copies[path]
        file = self._files.get(path)
        if file is None:
            return path
        included = {name: self._included(other.resolve()) for name, other in file.includes}
        changed = {name: copy for name, copy in included.items() if copy in self.originals}
        if not changed and file.main not in self._changed:
            return self._copies.setdefault(path, path)
        if not self._folder:
            self._folder = mkdtemp(prefix="cpid-model-")
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        place = Path(self._folder, str(len(self.originals)), path.name)
        place.parent.mkdir()
        self.originals[place] = path
        place.write_bytes(_text(file, included if file.ending == ".xml" else changed))
        return self._copies.setdefault(path, place)

    def _included(self, path: Path) -> Path:
        """Return the copy of a file, or of a model in a folder; the path itself if unchanged."""
        files = sorted(path.glob("*.sdf")) if path.is_dir() else [path]
        copies = [self._copy_of(each.resolve()) for each in files]
        return next((copy for copy in copies if copy in self.originals), path)


def _text(file: FileContent, included: Mapping[Element | str, Path]) -> bytes:
    """Return the text of a copy; what it includes is elsewhere."""
    if file.xml is None:
        content = file.path.read_text(encoding="utf-8")
        for name, place in included.items():
            content = re.sub(rf"{re.escape(str(name))}(?![\w./-])", f"file://{place}", content)
        return content.encode()
    whole, heads, folder = dict(file.whole), dict(file.heads), file.path.parent
    for element in file.xml.places:
        file_name, text = element.get("filename", ""), (element.text or "").strip()
        uri = element.find("uri")
        if element in included and uri is not None:
            whole[uri] = f"<uri>file://{included[element]}</uri>"
        elif element in included:
            heads[element] = {**element.attrib, "file": str(included[element])}
        elif element in file.meshes:
            heads[element] = {**element.attrib, "file": str(file.meshes[element])}
        elif _is_relative(file_name):
            heads[element] = {**element.attrib, "filename": str(folder / file_name)}
        elif element.tag == "uri" and element not in whole and _is_relative(text):
            whole[element] = f"<uri>file://{escape(str(folder / text))}</uri>"
    return file.xml.changed(whole, heads)


def _is_relative(name: str) -> bool:
    return bool(name) and "://" not in name and not Path(name).is_absolute()
