"""Masses and inertias of the links of a model file: those that no rigid body has, and the nearest.

Drake puts another inertia in the place of one that no body has. A figure that bodies may have, but
hardly this link, such as an inertia copied from another link, is implausible.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.multibody.tree import RotationalInertia

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import inside_the_limits
from cpid_drake.dynamics.parameterizations import vector_to_tensor
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.model_check import MOMENTS

Repair = Literal["nearest"]
"""How bodies that cannot be are repaired: each becomes the nearest body that can."""

UNLIKE = 10.0
"""Least ratio of the masses of two links whose equal inertias are implausible."""


@dataclass(frozen=True)
class BodyFinding:
    """A figure of a link that no body has, or that this link hardly has.

    Attributes:
        link: the link's name.
        figure: the figure in the file.
        possible: what is possible.
        impossible: whether no body has it.

    """

    link: str
    figure: str
    possible: str
    impossible: bool = True

    def __str__(self) -> str:
        return f"link '{self.link}': {self.figure}: {self.possible}"


@dataclass(frozen=True, eq=False)
class LinkInertia:
    """The mass and the inertia of a link as its file says it.

    Attributes:
        name: the link.
        where: the file and the line, for messages.
        mass: the mass as written [kg].
        moments: (6,) xx, yy, zz, xy, xz, yz about the centre of mass [kg·m²].
        element: the element that contains the moments.

    """

    name: str
    where: str
    mass: str
    moments: Array
    element: Element

    def findings(self) -> Iterator[BodyFinding]:
        """Yield why no body has them; nothing if one does."""
        mass, values = float(self.mass), self.moments.tolist()
        is_valid = RotationalInertia(*values).CouldBePhysicallyValid()
        figure = f"no rigid body has the mass {self.mass} and the inertia {values}"
        if mass < 0:
            yield BodyFinding(self.name, figure, "a mass is positive, and 0 of a link without mass")
        elif mass == 0 and any(values):
            remedy = "without a mass the inertia is 0; or merge the link with its neighbour"
            yield BodyFinding(self.name, figure, remedy)
        elif not is_valid:
            low, middle, high = np.linalg.eigvalsh(self.tensor)
            remedy = (
                f"principal moments are positive, and none exceeds the sum of the other two; here "
                f"they are {low:.3g}, {middle:.3g} and {high:.3g}"
            )
            if values[2] > 0 and not any(values[:2]):
                remedy = "on a table ixx and iyy do not matter: write the value of izz for both"
            yield BodyFinding(self.name, figure, remedy)

    @property
    def tensor(self) -> Array:
        """(3, 3) inertia about the centre of mass [kg·m²]."""
        xx, yy, zz, xy, xz, yz = self.moments
        return vector_to_tensor(np.array([xx, xy, xz, yy, yz, zz]))

    def nearest(self) -> Array:
        """Return the moments (6,) of the nearest body of this mass.

        Raises:
            InputError: the mass is negative.

        """
        mass = float(self.mass)
        if mass < 0:
            raise InputError(f"{self.where}link '{self.name}': no body is nearest to {mass:g} kg")
        if mass == 0:
            return np.zeros(6)
        body = inside_the_limits(mass, np.zeros(3), self.tensor)
        return body[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def link_inertias(element: Element, ending: str, where: str) -> Iterator[LinkInertia]:
    """Yield the mass and the inertia that a link or a body of a file has, or nothing.

    Raises:
        InputError: a moment is missing in URDF.

    """
    name = element.get("name", "")
    for inertial in element.findall("inertial"):
        place = inertial
        if ending == ".xml":
            words = inertial.get("fullinertia") or inertial.get("diaginertia") or "0 0 0"
            mass, moments = inertial.get("mass", "0"), [*words.split(), "0", "0", "0"][:6]
        elif ending == ".sdf":
            mass = inertial.findtext("mass") or "1"
            given = [inertial.findtext(f"inertia/{key}") for key in MOMENTS]
            moments = [text or default for text, default in zip(given, "111000", strict=True)]
            place = inertial if (child := inertial.find("inertia")) is None else child
        else:
            parts = {part.tag: part for part in inertial}
            mass = parts["mass"].get("value", "0") if "mass" in parts else "0"
            tensor = parts["inertia"].attrib if "inertia" in parts else {}
            missing = [key for key in MOMENTS if key not in tensor and "inertia" in parts]
            if missing:
                raise InputError(f"{where}link '{name}': <inertia> has no attribute '{missing[0]}'")
            moments, place = [tensor.get(key, "0") for key in MOMENTS], parts.get("inertia", place)
        yield LinkInertia(name, where, mass, np.array([float(m) for m in moments]), place)


def repair(link: LinkInertia, ending: str) -> tuple[str, dict[str, str]]:
    """Return the nearest body's moments as text of the element, or as its attributes.

    Raises:
        InputError: the mass is negative.

    """
    values = [repr(value) for value in link.nearest().tolist()]
    if ending == ".sdf":
        inner = "".join(f"<{key}>{text}</{key}>" for key, text in zip(MOMENTS, values, strict=True))
        return f"<inertia>{inner}</inertia>", {}
    if ending == ".urdf":
        return "", {**link.element.attrib, **dict(zip(MOMENTS, values, strict=True))}
    key = "fullinertia" if "fullinertia" in link.element.attrib else "diaginertia"
    count = 6 if key == "fullinertia" else 3
    return "", {**link.element.attrib, key: " ".join(values[:count])}


def change_of(link: LinkInertia) -> str:
    """Return what the nearest body changes, in words."""
    near = link.nearest()
    size = np.abs(link.moments).max()
    share = np.abs(near - link.moments).max() / size if size else 0.0
    values = ", ".join(f"{value:.4g}" for value in near)
    return (
        f"link '{link.name}': the inertia [{values}] of the nearest body takes the place of "
        f"{link.moments.tolist()}, a change of {100 * share:.3g} %"
    )


def copied(links: Iterable[LinkInertia]) -> Iterator[BodyFinding]:
    """Yield for each inertia that links of quite different masses have."""
    alike: dict[tuple[float, ...], list[LinkInertia]] = {}
    for link in links:
        if float(link.mass) > 0:
            alike.setdefault(tuple(link.moments.tolist()), []).append(link)
    for moments, group in alike.items():
        small, *_, large = sorted([*group, *group], key=lambda each: float(each.mass))
        if any(moments) and float(large.mass) > UNLIKE * float(small.mass):
            yield BodyFinding(
                small.name,
                f"{small.mass} kg with the inertia of '{large.name}', of {large.mass} kg "
                f"({len(group)} links have it)",
                "the inertia of another mass is another: it may be a copy",
                impossible=False,
            )
