"""All files of a model, checked, and what Drake does not report of them.

Drake's readers do not return from a file that includes itself.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

from pydrake.multibody.parsing import LoadModelDirectives, PackageMap
from pydrake.multibody.plant import MultibodyPlant

from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.link_inertia import LinkInertia, link_inertias
from cpid_drake.spacecraft.mimic_joints import Mimic
from cpid_drake.spacecraft.mjcf_meshes import mesh_files, unread_meshes
from cpid_drake.spacecraft.model_check import check_meaning, check_numbers, is_number
from cpid_drake.spacecraft.model_xml import XmlText, read_xml
from cpid_drake.spacecraft.parsing import make_parser, message_of

MOST_FILES = 1000
"""Most included files: models have tens, and files that include each other twice have billions."""


@dataclass(frozen=True, eq=False)
class FileContent:
    """A file of a model.

    Attributes:
        path: the file.
        main: the MJCF file that includes this one, at whose folder its paths start; else the file.
        xml: its text; None of directives.
        includes: the files that it includes, each as often as it does, with the element or the URI
            that names them.
        meshes: the files of meshes of MJCF, by the elements that name them.
        whole, heads: what is changed in a copy for Drake, see `XmlText.changed`.

    """

    path: Path
    main: Path
    xml: XmlText | None
    includes: list[tuple[Element | str, Path]] = field(default_factory=list)
    meshes: dict[Element, Path] = field(default_factory=dict)
    whole: dict[Element, str] = field(default_factory=dict)
    heads: dict[Element, Mapping[str, str]] = field(default_factory=dict)

    @property
    def ending(self) -> str:
        """The ending of its name, in small letters."""
        return self.path.suffix.lower()


@dataclass(frozen=True, eq=False)
class ModelContent:
    """What the files of a model contain that Drake does not report.

    Attributes:
        files: all files.
        efforts: effort limits of joints in URDF files [N·m or N]: Drake reads only those with a
            transmission.
        hollow: links of URDF and SDF files with a geometry and no inertia: Drake takes their mass
            for zero (URDF) or for 1 kg (SDF).
        links: masses and inertias of the links as they are written, by their files.
        mimics: what files say of joints that follow others, by name; None of the others.
        unread: how often an element is not read that changes no mass, joint or frame.

    """

    files: dict[Path, FileContent] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)
    hollow: set[str] = field(default_factory=set)
    links: dict[Path, list[LinkInertia]] = field(default_factory=dict)
    mimics: dict[str, Mimic | None] = field(default_factory=dict)
    unread: Counter[str] = field(default_factory=Counter)


def read_content(path: Path, where: str, folders: Mapping[str, Path]) -> ModelContent:
    """Check a model that Drake might never finish reading, or might read as another one.

    Raises:
        InputError: the file, or one that it includes, is not XML or YAML, includes itself, or
            contains entities, text in place of a number, or what Drake would ignore. The message
            names the file and the line.

    """
    content = ModelContent()
    packages, count = make_parser(MultibodyPlant(0.0), folders).package_map(), 0

    def visit(file: Path, around: tuple[Path, ...]) -> None:
        nonlocal count
        count += 1
        place = where if not around else f"{where}: {file}"
        if file in around:
            raise InputError(f"{place}: the file includes itself")
        if count > MOST_FILES:
            raise InputError(f"{place}: more than {MOST_FILES} includes")
        if file.is_dir():
            for other in sorted(file.glob("*.sdf")):
                visit(other.resolve(), (*around, file))
            return
        endings = (".urdf", ".sdf", ".xml", ".yaml", ".yml")
        if file.suffix.lower() not in endings or not file.exists():
            return  # of a missing one, Drake's own error names the file that includes it
        if not file.is_file():
            raise InputError(f"{place}: not a file")
        if file not in content.files:
            main = next((each for each in around if each.suffix.lower() == ".xml"), file)
            content.files[file] = _read(file, main, place, packages, content)
        for _, other in content.files[file].includes:
            visit(other.resolve(), (*around, file))

    try:
        visit(path.resolve(), ())
        _leave_out_meshes(content, where)
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{where}: {message_of(error, path):.500}") from error
    return content


def _read(
    file: Path, main: Path, place: str, packages: PackageMap, model: ModelContent
) -> FileContent:
    """Return one file, and add what it contains."""
    if file.suffix.lower() in (".yaml", ".yml"):
        content = FileContent(file, main, None)
        for each in LoadModelDirectives(str(file)).directives:
            for one in filter(None, (each.add_model, each.add_directives)):
                content.includes.extend((one.file, path) for path in _behind(one.file, packages))
        return content
    content = FileContent(file, main, read_xml(file, place))
    assert content.xml is not None
    ending, places = content.ending, content.xml.places
    for element, at in places.items():
        check_numbers(element, ending, f"{place}: line {at.line}: ")
    links = model.links[file] = list[LinkInertia]()
    for element, at in places.items():
        parts, name, line = {part.tag for part in element}, element.get("name", ""), at.line
        if unread := check_meaning(element, ending, f"{place}: line {line}: "):
            model.unread.update(unread)
        if element.tag in ("link", "body"):
            links += link_inertias(element, ending, f"{place}: line {line}: ")
        if element.tag == "link" and "inertial" not in parts:
            model.hollow.update([name] if parts & {"visual", "collision"} else [])
        elif element.tag == "joint" and ending == ".urdf":
            for limit in element.iter("limit"):
                model.efforts[name] = float(limit.get("effort", 0))
            if element.get("type") == "floating" and "child" in parts:
                content.whole.update(_freeing(element, content.xml))
        if element.tag == "joint" and "child" in parts:
            mimic = _mimic(element, f"{place}: line {line}: ")
            content.whole.update(dict.fromkeys(element.iter("mimic"), ""))
            if model.mimics.setdefault(name, mimic) != mimic:
                raise InputError(
                    f"{place}: line {line}: joint '{name}' follows another one in one file, and "
                    "not, or otherwise, in another: give the joints other names"
                )
        if element.tag == "include" and ending == ".xml":
            content.includes.append((element, main.parent / element.get("file", "")))
        elif element.tag == "include":
            uri = (element.findtext("uri") or "").strip()
            content.includes.extend((element, path) for path in _behind(uri, packages))
    if ending == ".urdf":
        joints = {each.get("name") for each in content.xml.root.findall("joint")}
        for each in content.xml.root.findall("transmission"):
            if any(end.get("name") not in joints for end in each.findall("joint")):
                content.whole[each] = ""
                model.unread["transmission of no joint"] += 1
    return content


def _leave_out_meshes(content: ModelContent, where: str) -> None:
    """Leave out meshes of MJCF that Drake cannot read, where masses do not depend on them."""
    for main in {file.main for file in content.files.values() if file.ending == ".xml"}:
        files = [file for file in content.files.values() if file.main == main]
        texts = [file.xml for file in files if file.xml is not None]
        meshes = mesh_files(texts, main.parent)
        for file in files:
            if file.xml is None:
                continue
            place = where if file.path == main else f"{where}: {file.path}"
            unread = unread_meshes(file.xml, texts, meshes, place)
            file.meshes.update((each, path) for each, path in meshes.items() if each not in unread)
            file.whole.update(dict.fromkeys(unread, ""))
            count = sum(each.tag == "mesh" for each in unread)
            content.unread.update({"mesh that is absent or no .obj": count} if count else {})


def _mimic(joint: Element, where: str) -> Mimic | None:
    """Return which joint a joint of URDF or SDF follows; None if it follows none or is fixed.

    Raises:
        InputError: a number of it is none.

    """
    mimic = next(joint.iter("mimic"), None)
    if mimic is None or joint.get("type") == "fixed":
        return None
    number = dict[str, float]()
    for key, default in (("multiplier", "1"), ("offset", "0"), ("reference", "0")):
        word = (mimic.get(key) or mimic.findtext(key) or default).strip()
        if not is_number(word):
            raise InputError(f"{where}<mimic {key}>: {word:.40} is not a finite number")
        number[key] = float(word)
    offset = number["offset"] - number["multiplier"] * number["reference"]
    return Mimic(mimic.get("joint", ""), number["multiplier"], offset)


def _freeing(joint: Element, xml: XmlText) -> dict[Element, str]:
    """Return the elements to leave out so that the child of a floating joint is free.

    They are the joint, and its parent if that is a mere name of the world: a link of no content
    that no other joint joins.
    """
    parent = joint.find("parent")
    name = "" if parent is None else parent.get("link", "")
    links = [each for each in xml.root.findall("link") if each.get("name") == name]
    ends = [end for each in xml.root.findall("joint") for end in each if end.get("link") == name]
    is_world = len(ends) == 1 and name != "world" and not any(len(link) for link in links)
    return dict.fromkeys([joint, *(links if is_world else [])], "")


def _behind(uri: str, packages: PackageMap) -> Iterator[Path]:
    """Yield the path of a URI's file; nothing if Drake will refuse the URI."""
    scheme, separator, rest = uri.partition("://")
    if separator and (scheme == "file" or packages.Contains(rest.partition("/")[0])):
        yield Path(rest) if scheme == "file" else Path(packages.ResolveUrl(f"package://{rest}"))
