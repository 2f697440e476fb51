"""Writes the target as a model file, alone or with the spacecraft that holds it.

Every number is written with all its digits.
"""

import re
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, FrameIndex, JointIndex, ModelInstanceIndex

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.drafts import draft_of
from cpid_drake.files.errors import InputError
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.spacecraft.spacecraft import Spacecraft

FORMATS = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml", "drake-yaml": ".dmd.yaml"}
"""The formats that can be written, and the endings of their file names."""

WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
"""Comment at the beginning of every file."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


@dataclass(frozen=True, eq=False)
class Link:
    """A link and the joint to its parent, whose frame at q = 0 is the link's own frame L.

    Attributes:
        body: mass, centre of mass and inertia in L; None without mass.
        kind: "revolute", "prismatic" or "fixed"; empty for the first link, which is free.
        limits: lowest and highest position, and largest rate; infinite for none.
        mimic: the joint that the joint follows, and its multiplier; None if it follows none.

    """

    name: str
    body: InertialParameters | None
    parent: str = ""
    joint: str = ""
    kind: str = ""
    X_PL: RigidTransform = field(default_factory=RigidTransform)
    axis_L: Array | None = None
    limits: tuple[float, float, float] = (-np.inf, np.inf, np.inf)
    mimic: tuple[str, float] | None = None

    @property
    def finite_limits(self) -> list[tuple[str, float]]:
        """The limits that are not infinite, with their names in URDF and SDF."""
        named = zip(("lower", "upper", "velocity"), self.limits, strict=True)
        return [(name, value) for name, value in named if np.isfinite(value)]

    @property
    def rpy_PL(self) -> Array:
        """(3,) roll, pitch and yaw of the link in its parent."""
        return np.asarray(RollPitchYaw(self.X_PL.rotation()).vector())

    @property
    def moments(self) -> list[tuple[str, float]]:
        """The moments of inertia, with their names in URDF and SDF."""
        assert self.body is not None
        names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        return list(zip(names, self.body.to_vector()[4:].tolist(), strict=True))


def export_target(
    path: str | Path,
    parameters: InertialParameters,
    *,
    format: str,
    spacecraft: Spacecraft | None = None,
    name: str | None = None,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write the target as a model file; its link's frame is the capture frame C.

    Readers round numbers. A flat or rod-shaped body whose principal axes are not C's axes is
    therefore written with principal moments larger by 1e-13 of their sum, which readers accept.

    Args:
        path: the file to write, in a folder that exists.
        parameters: physically consistent inertial parameters.
        format: "urdf", "sdf" or "mjcf", or "drake-yaml" for Drake model directives. Directives
            contain absolute paths; they add the target's URDF, which is written beside them.
        spacecraft: if given, the file contains it with the target fixed on C. Directives add the
            spacecraft's own model, with its geometry. The other formats are written anew, with
            links, joints and their limits, but without geometry.
        name: name of the target's link; default: `target`, with a number if that name is taken.
        overwrite: whether an existing `path` is replaced.

    Returns:
        The requested file, and the file that it refers to, if any.

    Raises:
        InputError: no rigid body has the parameters, the format is unknown, the name is taken or
            not plain, the file exists, the folder cannot be written to, or names of the spacecraft
            are not unique, or Drake does not read these parameters from the file. In all these
            cases no file is written.

    """
    path = Path(path)
    problems = parameters.inconsistencies()
    if problems:
        raise InputError(f"{path}: not written: no rigid body has this: {'; '.join(problems)}")
    if format not in FORMATS:
        raise InputError(f"no format '{format}'; choose from {', '.join(FORMATS)}")
    ending = FORMATS[format]
    if not path.name.endswith(ending) or path.name == ending:
        raise InputError(f"{path}: the name of a file in format {format} must end in {ending}")
    name = free_name(name, spacecraft)
    target = Link(name, _clear_of_the_limits(parameters))

    if format != "drake-yaml":
        links = [target] if spacecraft is None else _links(spacecraft, target)
        followers = [link.joint for link in links if link.mimic is not None]
        if followers and format != "urdf":
            raise InputError(
                f"{path}: joint '{followers[0]}' follows another one (mimic), which is written in "
                "format urdf or drake-yaml only"
            )
        texts = {path: model_text(format, links)}
    else:
        if spacecraft is not None and spacecraft.file.is_repaired:
            raise InputError(
                f"{path}: the spacecraft's bodies are repaired, and directives name its own file: "
                "choose another format"
            )
        beside = path.with_name(f"{path.name.removesuffix(ending)}_{name}.urdf")
        texts = {path: _directives(beside, name, spacecraft), beside: model_text("urdf", [target])}
    for place, text in texts.items():
        _check_reading(place, text, target)
    sources = () if spacecraft is None else (spacecraft.path,)
    check_outputs([("", place) for place in texts], sources, force=overwrite)
    with ExitStack() as drafts:  # the last is moved to its place first: the directives refer to it
        for place, text in texts.items():
            drafts.enter_context(draft_of(place)).write_text(text, encoding="utf-8")
    return tuple(texts)


# -- names and numbers ---------------------------------------------------------------------------


def _weld_name(name: str) -> str:
    """Return the name of the joint that fixes a target of this name."""
    return f"{name}_weld"


def free_name(name: str | None, spacecraft: Spacecraft | None) -> str:
    """Return a name that is free for the target's link, model instance and (with "_weld") joint."""
    if name is not None and not _NAME.fullmatch(name):
        raise InputError(
            f"the name {name!r:.80} cannot be used: a letter, then letters, digits, _ and - (at "
            "most 64)"
        )
    taken = {"world"}
    if spacecraft is not None:
        plant = spacecraft.plant
        taken |= {plant.get_frame(FrameIndex(k)).name() for k in range(plant.num_frames())}
        taken |= {plant.get_body(BodyIndex(k)).name() for k in range(plant.num_bodies())}
        taken |= {plant.get_joint(JointIndex(k)).name() for k in plant.GetJointIndices()}
        for k in range(plant.num_model_instances()):
            taken |= set(plant.GetModelInstanceName(ModelInstanceIndex(k)).split("::"))
    choices = [name] if name else chain(["target"], (f"target_{k}" for k in count(2)))
    for choice in choices:
        if not {choice, _weld_name(choice)} & taken:
            return choice
    raise InputError(f"the name '{name}' is taken already; choose another")


def _clear_of_the_limits(target: InertialParameters) -> InertialParameters:
    """Return parameters that remain physically consistent after a reader has rounded them."""
    inertia, total = target.I_TTcm_C, np.trace(target.I_TTcm_C)
    low, middle, high = target.principal_moments()
    along_axes = not np.any(inertia - np.diag(np.diag(inertia)))
    exact = along_axes and low > 0 and low + middle >= high
    if exact or min(low, low + middle - high) > 1e-13 * total:
        return target
    return InertialParameters(target.mass, target.p_CTcm_C, inertia + 1e-13 * total * np.eye(3))


def _check_reading(place: Path, text: str, target: Link) -> None:
    """Refuse a model from which Drake reads another target than the one that is written."""
    if place.name.endswith(FORMATS["drake-yaml"]):
        return  # it names the file beside it
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModelsFromString(text, place.suffix[1:])
    inertia = plant.GetBodyByName(target.name).default_spatial_inertia()
    assert target.body is not None
    written, read = target.body.to_vector(), InertialParameters.from_spatial_inertia(inertia)
    size = np.abs(written).max()
    if not np.allclose(read.to_vector(), written, rtol=1e-9, atol=1e-12 * size):
        raise InputError(
            f"{place}: not written: Drake would read {read.to_vector()} from it instead of "
            f"{written}; choose another format"
        )


# -- links ---------------------------------------------------------------------------------------


def _links(spacecraft: Spacecraft, target: Link) -> list[Link]:
    """Return the links of a spacecraft with the target fixed on C, inboard before outboard."""
    tree, limits, links = spacecraft.tree, spacecraft.limits, list[Link]()
    for body in tree.bodies:
        parameters = None
        if body.mass > 0:
            inertia = (body.I_BBcm + body.I_BBcm.T) / 2
            parameters = InertialParameters(body.mass, body.p_BBcm, inertia)
            parameters = _clear_of_the_limits(parameters)
        link, k = Link(body.name, parameters), body.joint
        if body.parent >= 0:
            parent, X_PF = (
                links[body.parent].name,
                RigidTransform(RotationMatrix(body.R_PF), body.p_PF),
            )
            link = replace(
                link, parent=parent, joint=_weld_name(body.name), kind="fixed", X_PL=X_PF
            )
        if k >= 0:
            kind, name = "prismatic" if body.prismatic else "revolute", spacecraft.joint_names[k]
            ends = float(limits.lowest[k]), float(limits.highest[k]), float(limits.rates[k])
            link = replace(link, joint=name, kind=kind, axis_L=body.axis_F, limits=ends)
        if body.follows and k >= 0:
            m = body.multiplier
            low, high = sorted(m * end for end in link.limits[:2]) if m else (0.0, 0.0)
            ends = low, high, abs(m) * link.limits[2]
            link = replace(link, joint=body.joint_name, limits=ends, mimic=(name, m))
        links.append(link)
    X_BC = RigidTransform(RotationMatrix(tree.R_BC), tree.p_BC)
    parent, X_PL = links[tree.capture_body].name, X_BC
    capture = spacecraft.capture_frame.name()
    if capture not in [link.name for link in links]:  # C keeps its name, as a link without mass
        links.append(Link(capture, None, parent, _weld_name(capture), "fixed", X_PL))
        parent, X_PL = capture, RigidTransform()
    weld = _weld_name(target.name)
    links.append(Link(target.name, target.body, parent, weld, "fixed", X_PL))
    names = [name for link in links for name in (link.name, link.joint) if name]
    if len({*names}) < len(names) or any("::" in name for name in names):
        raise InputError(
            f"{spacecraft.model}: several of its links or joints have the same name; use format "
            "drake-yaml, which adds the model as it is"
        )
    return links


def _directives(target_file: Path, name: str, spacecraft: Spacecraft | None) -> str:
    """Return Drake model directives that add the target, and the spacecraft that holds it."""
    target = {"add_model": {"name": name, "file": f"file://{target_file.resolve()}"}}
    items: list[dict[str, dict[str, Any]]] = [target]
    if spacecraft is not None:
        file = f"file://{spacecraft.path}"  # a package:// URI would need a map of packages
        instance = spacecraft.plant.GetModelInstanceName(spacecraft.base.model_instance())
        kept = (
            {"add_directives": {"file": file}}
            if spacecraft.path.name.endswith(FORMATS["drake-yaml"])
            else {"add_model": {"name": instance.partition("::")[0], "file": file}}
        )
        frame = spacecraft.capture_frame.scoped_name().get_full()
        weld = {"add_weld": {"parent": frame, "child": f"{name}::{name}"}}
        items = [kept, target, weld]
    text = yaml.safe_dump(
        {"directives": items}, sort_keys=False, allow_unicode=True, width=float("inf")
    )
    return f"# {WHAT}\n{text}"


# -- text ----------------------------------------------------------------------------------------


def model_text(format: str, links: Sequence[Link]) -> str:
    """Return the text of a model in "urdf", "sdf" or "mjcf"; links are inboard before outboard."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cpid_drake.spacecraft"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["numbers"] = _numbers
    return environment.get_template(f"{format}.xml").render(links=links, what=WHAT).lstrip()


def _numbers(values: ArrayLike) -> str:
    numbers = np.ravel(np.asarray(values, dtype=float))
    # Some readers refuse numbers below the smallest normal number.
    numbers = np.where(np.abs(numbers) < sys.float_info.min, 0.0, numbers)
    return " ".join(map(repr, numbers.tolist()))
