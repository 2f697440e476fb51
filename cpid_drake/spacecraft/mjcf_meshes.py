"""Meshes of MJCF whose files Drake cannot read: left out where they have no part in a mass."""

from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.model_xml import XmlText

FORMAT = ".obj"
"""The ending of the meshes that Drake reads in MJCF."""


def mesh_files(texts: Iterable[XmlText], folder: Path) -> dict[Element, Path]:
    """Return the files of the meshes of a model in MJCF, by the elements that name them.

    Args:
        texts: the texts of all its files.
        folder: the folder of the first.

    """
    places = [element for text in texts for element in text.places]
    compilers = [each for each in places if each.tag == "compiler"]
    folders = [each.get("meshdir") or each.get("assetdir") for each in compilers]
    within = folder.joinpath(*filter(None, folders[-1:]))
    return {
        each: within / each.get("file", "")
        for each in places
        if each.tag == "mesh" and each.get("file")
    }


def unread_meshes(
    text: XmlText, texts: Iterable[XmlText], files: dict[Element, Path], where: str
) -> list[Element]:
    """Return the elements of one text to leave out, because Drake cannot read the meshes' files.

    Raises:
        InputError: a body takes its mass from such a mesh.

    """
    from_geoms = any(
        each.get("inertiafromgeom") == "true"
        for other in texts
        for each in other.places
        if each.tag == "compiler"
    )
    bad = {
        each.get("name") or file.stem: file
        for each, file in files.items()
        if file.suffix.lower() != FORMAT or not file.is_file()
    }
    around = {inner: outer for outer in text.places for inner in outer}
    unread = [each for each in text.places if each in files and files[each] in bad.values()]
    for geom in text.places:
        name = geom.get("mesh", "")
        if geom.tag != "geom" or name not in bad:
            continue
        body, file = around[geom], bad[name]
        is_explicit = body.find("inertial") is not None and not from_geoms
        if not (is_explicit or body.tag == "worldbody"):
            owner = f"<{body.tag}> '{body.get('name') or body.get('class') or ''}'"
            raise InputError(
                f"{where}: line {text.places[geom].line}: {owner} may take its mass from mesh "
                f"'{name}', whose file {file} is {f'no {FORMAT}' if file.is_file() else 'absent'}: "
                "give the body an <inertial> of its own"
            )
        unread.append(geom)
    return unread
