"""The target as a model file, alone or attached to the user's own spacecraft.

Every number is written with all its digits, every file is read again by Drake and compared with
what was meant before it takes its place.
"""

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from uuid import uuid4
from xml.sax.saxutils import escape, unescape

import numpy as np
import yaml
from numpy.typing import ArrayLike
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, FrameIndex, JointIndex, ModelInstanceIndex

from cpid_drake.errors import InputError
from cpid_drake.inertia import InertialParameters
from cpid_drake.kinematics import TreeBody
from cpid_drake.spacecraft import Spacecraft
from cpid_drake.xml_edits import Element, XmlEdits, attribute_text

FORMATS = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml", "drake-yaml": ".dmd.yaml"}
"""What can be written, and how the names of such files end."""

_WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
_TOLERANCE = 1e-12
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")


@dataclass(frozen=True)
class Exported:
    """What has been written.

    Attributes:
        name: of the target's link (or body).
        files: the file that was asked for, and the one that it needs beside it, if any.

    """

    name: str
    files: tuple[Path, ...]


def export_target(
    parameters: InertialParameters,
    path: str | Path,
    *,
    format: str,
    spacecraft: Spacecraft | None = None,
    name: str | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write the target as a model file, its link's frame being the capture frame C.

    A flat or rod-shaped body along other axes than C's gets principal moments larger by 1e-13 of
    their sum: the rounding of readers would put it beyond what they accept.

    Args:
        parameters: physically possible ones.
        path: the file to write, in a folder that exists.
        format: "urdf", "sdf" or "mjcf", or "drake-yaml" for Drake model directives, which add the
            target's URDF, written beside them. Directives hold absolute paths.
        spacecraft: if given, its model is written with the target fixed on C: a URDF, SDF or MJCF
            as an edited copy, comments and all; any of them by directives.
        name: of the target's link; default: `target`, with a number if the spacecraft has that.
        overwrite: whether `path` may exist.

    Raises:
        InputError: parameters that no rigid body has, an unknown format, a name that is taken or
            not a plain one, a file that exists, a folder that cannot be written to, a spacecraft
            in another format or split over several files, or a file that Drake does not read as
            meant (it is not written then).

    """
    path = Path(path)
    problems = parameters.infeasibilities()
    if problems:
        raise InputError(f"{path}: not written: no rigid body has this: {'; '.join(problems)}")
    if format not in FORMATS:
        raise InputError(f"no format '{format}'; choose from {', '.join(FORMATS)}")
    ending = FORMATS[format]
    if not path.name.endswith(ending) or path.name == ending:
        raise InputError(f"{path}: the name of a file in format {format} must end in {ending}")
    name = _free_name(name, spacecraft)
    target = _clear_of_the_limits(parameters)

    def check(file: Path) -> None:
        if spacecraft is None:
            _check_alone(file, name, parameters)
        else:
            _check_attached(spacecraft.reread(file), spacecraft, name, parameters)

    _require_free(path, spacecraft, overwrite)
    if format != "drake-yaml":
        data = (
            _alone(target, name, format).encode()
            if spacecraft is None
            else _attached(target, name, format, spacecraft, path)
        )
        _write_checked(path, data, check)
        return Exported(name, (path,))

    link = path.with_name(f"{path.name.removesuffix(ending)}_{name}.urdf")
    _require_free(link, spacecraft, overwrite)
    directives = _directives(link, name, spacecraft).encode()
    data = _alone(target, name, "urdf").encode()
    new = not link.exists()
    _write_checked(link, data, lambda file: _check_alone(file, name, parameters))
    try:
        _write_checked(path, directives, check)
    except InputError:
        if new:
            link.unlink()
        raise
    return Exported(name, (path, link))


# -- names and numbers ---------------------------------------------------------------------------


def _free_name(name: str | None, spacecraft: Spacecraft | None) -> str:
    taken = {"world"}
    if spacecraft is not None:
        plant = spacecraft.plant
        taken |= {plant.get_frame(FrameIndex(k)).name() for k in range(plant.num_frames())}
        taken |= {plant.get_body(BodyIndex(k)).name() for k in range(plant.num_bodies())}
        taken |= {plant.get_joint(JointIndex(k)).name() for k in plant.GetJointIndices()}
        for k in range(plant.num_model_instances()):
            taken |= set(plant.GetModelInstanceName(ModelInstanceIndex(k)).split("::"))
    if name is not None and not _NAME.fullmatch(name):
        raise InputError(
            f"the name {name!r:.80} cannot be used: a letter, then letters, digits, _ and - (at "
            "most 64)"
        )
    if name is not None and {name, _joint_name(name)} & taken:
        raise InputError(f"the name '{name}' is taken in the spacecraft's model; choose another")
    number = 1
    free = name or "target"
    while {free, _joint_name(free)} & taken:
        number += 1
        free = f"target_{number}"
    return free


def _joint_name(name: str) -> str:
    return f"{name}_weld"


def _clear_of_the_limits(target: InertialParameters) -> InertialParameters:
    inertia, total = target.I_TTcm_C, np.trace(target.I_TTcm_C)
    low, middle, high = target.principal_moments()
    along_axes = not np.any(inertia - np.diag(np.diag(inertia)))
    exact = along_axes and low > 0 and low + middle >= high
    if exact or min(low, low + middle - high) > 1e-13 * total:
        return target
    return InertialParameters(target.mass, target.p_CTcm_C, inertia + 1e-13 * total * np.eye(3))


def _numbers(values: ArrayLike) -> str:
    values = np.ravel(np.asarray(values, dtype=float))
    # Some readers refuse numbers below the smallest normal one.
    values = np.where(np.abs(values) < sys.float_info.min, 0.0, values)
    return " ".join(repr(value) for value in values.tolist())


def _pose(spacecraft: Spacecraft) -> tuple[str, str, str]:
    """Return the position, roll-pitch-yaw and quaternion of C in its body's frame."""
    R_BC = RotationMatrix(spacecraft.tree.R_BC)
    rpy, quaternion = RollPitchYaw(R_BC).vector(), R_BC.ToQuaternion().wxyz()
    return _numbers(spacecraft.tree.p_BC), _numbers(rpy), _numbers(quaternion)


# -- the target alone ----------------------------------------------------------------------------

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _urdf_link(target: InertialParameters, name: str) -> str:
    moments = " ".join(
        f'{key}="{_numbers(value)}"' for key, value in zip(_MOMENTS, target.to_vector()[4:])
    )
    return f"""\
<!-- {_WHAT} -->
<link name="{name}">
  <inertial>
    <origin xyz="{_numbers(target.p_CTcm_C)}" rpy="0 0 0"/>
    <mass value="{_numbers(target.mass)}"/>
    <inertia {moments}/>
  </inertial>
</link>
"""


def _sdf_link(target: InertialParameters, name: str, pose: str = "") -> str:
    moments = "".join(
        f"\n      <{key}>{_numbers(value)}</{key}>"
        for key, value in zip(_MOMENTS, target.to_vector()[4:])
    )
    return f"""\
<!-- {_WHAT} -->
<link name="{name}">{pose}
  <inertial>
    <pose>{_numbers(target.p_CTcm_C)} 0 0 0</pose>
    <mass>{_numbers(target.mass)}</mass>
    <inertia>{moments}
    </inertia>
  </inertial>
</link>
"""


def _mjcf_body(target: InertialParameters, name: str, pose: str = "", inner: str = "") -> str:
    vector = target.to_vector()
    return f"""\
<!-- {_WHAT} -->
<body name="{name}"{pose}>{inner}
  <inertial pos="{_numbers(target.p_CTcm_C)}" mass="{_numbers(target.mass)}"
            fullinertia="{_numbers(vector[4:])}"/>
</body>
"""


def _alone(target: InertialParameters, name: str, format: str) -> str:
    if format == "urdf":
        return f'<?xml version="1.0"?>\n<robot name="{name}">\n{_urdf_link(target, name)}</robot>\n'
    if format == "sdf":
        return (
            f'<?xml version="1.0"?>\n<sdf version="1.9">\n<model name="{name}">\n'
            f"{_sdf_link(target, name)}</model>\n</sdf>\n"
        )
    body = _mjcf_body(target, name, inner="\n  <freejoint/>")
    return f'<mujoco model="{name}">\n<worldbody>\n{body}</worldbody>\n</mujoco>\n'


# -- attached to a spacecraft --------------------------------------------------------------------

_USE_DIRECTIVES = "use format drake-yaml, which adds the model as it is"


def _attached(
    target: InertialParameters, name: str, format: str, spacecraft: Spacecraft, path: Path
) -> bytes:
    if spacecraft.path.suffix != FORMATS[format]:
        raise InputError(
            f"{spacecraft.model}: not a model in format {format}; choose the model's own, or "
            f"{_USE_DIRECTIVES}"
        )
    try:
        edits = XmlEdits(spacecraft.path.read_bytes())
        _attach(edits, target, name, format, spacecraft)
        _move_files(edits, format, spacecraft.path.parent, path.resolve().parent)
    except InputError as error:
        raise InputError(f"{spacecraft.model}: {error}; {_USE_DIRECTIVES}") from error
    return edits.result()


def _attach(
    edits: XmlEdits, target: InertialParameters, name: str, format: str, spacecraft: Spacecraft
) -> None:
    body = spacecraft.capture_frame.body().name()
    xyz, rpy, quaternion = _pose(spacecraft)
    if format == "urdf":
        joint = f"""\
<joint name="{_joint_name(name)}" type="fixed">
  <parent link="{attribute_text(body)}"/>
  <child link="{name}"/>
  <origin xyz="{xyz}" rpy="{rpy}"/>
</joint>
"""
        edits.append(edits.elements[0], _urdf_link(target, name) + joint)
        return
    carrier = _carrier(edits, "link" if format == "sdf" else "body", spacecraft)
    if format == "sdf":
        pose = f'\n  <pose relative_to="{attribute_text(body)}">{xyz} {rpy}</pose>'
        joint = f"""\
<joint name="{_joint_name(name)}" type="fixed">
  <parent>{escape(body)}</parent>
  <child>{name}</child>
</joint>
"""
        edits.append(carrier.parent, _sdf_link(target, name, pose) + joint)
    else:
        pose = f' pos="{xyz}" quat="{quaternion}"'
        edits.append(carrier, _mjcf_body(target, name, pose))


def _carrier(edits: XmlEdits, tag: str, spacecraft: Spacecraft) -> Element:
    """Return the element of the body that carries C."""
    body = spacecraft.capture_frame.body()
    named = [e for e in edits.elements if e.tag == tag and e.attributes.get("name") == body.name()]
    if len(named) > 1:
        instance = spacecraft.plant.GetModelInstanceName(body.model_instance())
        named = [element for element in named if _scope(element) == instance]
    if len(named) != 1:
        raise InputError(f"the file itself has no {tag} '{body.name()}'")
    return named[0]


def _scope(element: Element) -> str:
    names = []
    while (element := element.parent) is not None:
        if element.tag == "model":
            names.append(element.attributes.get("name", ""))
    return "::".join(reversed(names))


def _move_files(edits: XmlEdits, format: str, old: Path, new: Path) -> None:
    """Make the relative paths of meshes and the like right for a file in another folder."""
    compiler = {}
    for element in edits.elements:
        if element.tag == "compiler":
            compiler |= element.attributes
    if old == new:
        return

    def move(reference: str) -> str | None:
        if not reference.strip() or "://" in reference or Path(reference.strip()).is_absolute():
            return None
        return os.path.relpath(old / reference.strip(), new)

    for element in edits.elements:
        if format == "sdf":
            if element.tag == "uri" or element.tag.endswith("_map"):
                moved = move(unescape(edits.text(element)))
                if moved:
                    edits.set_text(element, moved)
            continue
        for key in _path_attributes(element, format, compiler):
            moved = move(element.attributes.get(key, ""))
            if moved:
                edits.set_attribute(element, key, moved)


def _path_attributes(element: Element, format: str, compiler: dict[str, str]) -> tuple[str, ...]:
    """Return which attributes of an element are paths from the model's own folder."""
    if format == "urdf":
        return ("filename",) if element.tag in ("mesh", "texture") else ()
    if element.tag == "compiler":
        return ("meshdir", "texturedir", "assetdir")
    if element.tag == "include":
        raise InputError("files that it includes cannot follow it into another folder")
    if element.parent is None or element.parent.tag != "asset":
        return ()
    if {"texturedir" if element.tag == "texture" else "meshdir", "assetdir"} & compiler.keys():
        return ()
    if compiler.get("strippath") == "true":
        raise InputError("files whose path it strips cannot follow it into another folder")
    return ("file",)


def _directives(link: Path, name: str, spacecraft: Spacecraft | None) -> str:
    target = {"add_model": {"name": name, "file": f"file://{link.resolve()}"}}
    directives: list[dict] = [target]
    if spacecraft is not None:
        file = spacecraft.model if "://" in spacecraft.model else f"file://{spacecraft.path}"
        instance = spacecraft.plant.GetModelInstanceName(spacecraft.base.model_instance())
        known = (
            {"add_directives": {"file": file}}
            if spacecraft.path.name.endswith(FORMATS["drake-yaml"])
            else {"add_model": {"name": instance.partition("::")[0], "file": file}}
        )
        frame = spacecraft.capture_frame.scoped_name().get_full()
        weld = {"add_weld": {"parent": frame, "child": f"{name}::{name}"}}
        directives = [known, target, weld]
    text = yaml.safe_dump(
        {"directives": directives}, sort_keys=False, allow_unicode=True, width=float("inf")
    )
    return f"# {_WHAT}\n{text}"


# -- writing, and checking what was written ------------------------------------------------------


def _require_free(path: Path, spacecraft: Spacecraft | None, overwrite: bool) -> None:
    try:
        if path.is_dir() or (path.exists() and not overwrite):
            raise InputError(
                f"{path}: exists already; choose another name, or overwrite it (--force)"
            )
        if spacecraft is not None and path.resolve() == spacecraft.path:
            raise InputError(f"{path}: is the spacecraft's own model; choose another name")
        if not path.parent.is_dir():
            raise InputError(f"{path}: no such folder: {path.parent}")
    except OSError as error:
        raise InputError(f"{path!s:.200}: {error.strerror}") from error


def _write_checked(path: Path, data: bytes, check: Callable[[Path], None]) -> None:
    """Write a file beside its place, let it be checked, and move it there."""
    ending = next(ending for ending in FORMATS.values() if path.name.endswith(ending))
    draft = path.parent / f".{uuid4().hex}{ending}"
    try:
        try:
            draft.write_bytes(data)
            check(draft)
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path!s:.200}: cannot write there: {error.strerror}") from error
    except InputError as error:
        problem = str(error).replace(str(draft), "the file")
        raise InputError(f"{path}: not written, Drake reads it otherwise: {problem}") from error


def _check_alone(file: Path, name: str, target: InertialParameters) -> None:
    plant = MultibodyPlant(time_step=0.0)
    try:
        Parser(plant).AddModels(str(file))
        plant.Finalize()
    except (RuntimeError, ValueError, SystemExit) as error:
        raise InputError(str(error)) from error
    if plant.num_bodies() != 2 or not plant.HasBodyNamed(name):
        raise InputError(f"its one body is not '{name}'")
    inertia = plant.GetBodyByName(name).default_spatial_inertia()
    _require_equal(target, InertialParameters.from_spatial_inertia(inertia))


def _require_equal(meant: InertialParameters, read: InertialParameters) -> None:
    """Compare to 1e-12; inertia of what it is about the body's origin, as Drake holds it."""
    reach = np.linalg.norm(meant.p_CTcm_C)
    size = np.trace(meant.I_TTcm_C) + meant.mass * reach**2
    scale = np.array([meant.mass] + 3 * [reach] + 6 * [size])
    if not (np.abs(read.to_vector() - meant.to_vector()) <= _TOLERANCE * scale).all():
        raise InputError(f"the target is {read}, not {meant}")


def _check_attached(
    joined: Spacecraft, spacecraft: Spacecraft, name: str, target: InertialParameters
) -> None:
    """Require the spacecraft as it was, and the target fixed on C."""
    before, after = spacecraft.tree, joined.tree
    names = [body.name for body in after.bodies]
    if names.count(name) != 1:
        raise InputError(f"no body '{name}'")
    k = names.index(name)
    rest = after.bodies[:k] + after.bodies[k + 1 :]
    if not (
        joined.joint_names == spacecraft.joint_names
        and np.array_equal(joined.velocity_limits, spacecraft.velocity_limits)
        and len(rest) == len(before.bodies)
        and all(_same(old, new, k) for old, new in zip(before.bodies, rest))
    ):
        raise InputError("the spacecraft itself has changed")
    body = after.bodies[k]
    R_BT, p_BT = body.R_PF @ body.R_MB, body.p_PF + body.R_PF @ body.p_MB
    if not (
        body.joint == -1
        and body.parent - (body.parent > k) == before.capture_body
        and np.abs(R_BT - before.R_BC).max() <= _TOLERANCE
        and np.abs(p_BT - before.p_BC).max() <= _TOLERANCE * max(1, np.abs(before.p_BC).max())
    ):
        raise InputError("the target is not fixed on the capture frame")
    _require_equal(target, InertialParameters(body.mass, body.p_BBcm, body.I_BBcm))


def _same(old: TreeBody, new: TreeBody, target: int) -> bool:
    """Whether a body is as it was; behind the target, its parent's number is one more."""
    changed = replace(new, parent=new.parent - (new.parent > target))
    return all(np.array_equal(value, getattr(changed, key)) for key, value in vars(old).items())
