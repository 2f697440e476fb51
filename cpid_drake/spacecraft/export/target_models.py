"""The text of model files: a target alone, or a spacecraft's own file with the target in it."""

import os
import sys
from pathlib import Path
from xml.sax.saxutils import escape, unescape

import numpy as np
import yaml
from numpy.typing import ArrayLike
from pydrake.math import RollPitchYaw, RotationMatrix

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.export.xml_edits import Element, XmlEdits, attribute_text
from cpid_drake.spacecraft.spacecraft import Spacecraft

FORMATS = {"urdf": ".urdf", "sdf": ".sdf", "mjcf": ".xml", "drake-yaml": ".dmd.yaml"}
"""The formats that can be written, and the endings of their file names."""

_WHAT = "The captured target as identified by cpid_drake; its frame is the capture frame."
_USE_DIRECTIVES = "use format drake-yaml, which adds the model as it is"


def joint_name(name: str) -> str:
    """Return the name of the joint that fixes a target of this name."""
    return f"{name}_weld"


def _numbers(values: ArrayLike) -> str:
    values = np.ravel(np.asarray(values, dtype=float))
    # Some readers refuse numbers below the smallest normal number.
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


def target_alone(target: InertialParameters, name: str, format: str) -> str:
    """Return the text of a URDF, SDF or MJCF of one free body, the target, with C as its frame."""
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


def target_attached(
    target: InertialParameters, name: str, format: str, spacecraft: Spacecraft, path: Path
) -> bytes:
    """Return the content of the spacecraft's own file with the target fixed on C.

    Args:
        target: its inertial parameters.
        name: its link's name.
        format: the format of the spacecraft's model.
        spacecraft: the spacecraft's model, of which a copy is edited.
        path: where the result will be written; relative paths in it are changed accordingly.

    Raises:
        InputError: the model has another format, or other files would have to be edited too.

    """
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
<joint name="{joint_name(name)}" type="fixed">
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
<joint name="{joint_name(name)}" type="fixed">
  <parent>{escape(body)}</parent>
  <child>{name}</child>
</joint>
"""
        edits.append(carrier.parent or carrier, _sdf_link(target, name, pose) + joint)
    else:
        pose = f' pos="{xyz}" quat="{quaternion}"'
        edits.append(carrier, _mjcf_body(target, name, pose))


def _carrier(edits: XmlEdits, tag: str, spacecraft: Spacecraft) -> Element:
    """Return the element of the body on which C is fixed."""
    body = spacecraft.capture_frame.body()
    named = [e for e in edits.elements if e.tag == tag and e.attributes.get("name") == body.name()]
    if len(named) > 1:
        instance = spacecraft.plant.GetModelInstanceName(body.model_instance())
        named = [element for element in named if _scope(element) == instance]
    if len(named) != 1:
        raise InputError(f"the file itself has no {tag} '{body.name()}'")
    return named[0]


def _scope(element: Element) -> str:
    """Return the names of the SDF models around an element, outermost first."""
    names, around = [], element.parent
    while around is not None:
        if around.tag == "model":
            names.append(around.attributes.get("name", ""))
        around = around.parent
    return "::".join(reversed(names))


def _move_files(edits: XmlEdits, format: str, old: Path, new: Path) -> None:
    """Change relative paths of meshes and other files for a model in another folder."""
    if old == new:
        return
    compiler: dict[str, str] = {}
    for element in edits.elements:
        if element.tag == "compiler":
            compiler |= element.attributes

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
    """Return the attributes of an element that are paths relative to the model's folder."""
    if format == "urdf":
        return ("filename",) if element.tag in ("mesh", "texture") else ()
    if element.tag == "compiler":
        return ("meshdir", "texturedir", "assetdir")
    if element.tag == "include":
        raise InputError("files that it includes cannot be found from another folder")
    if element.parent is None or element.parent.tag != "asset":
        return ()
    if {"texturedir" if element.tag == "texture" else "meshdir", "assetdir"} & compiler.keys():
        return ()
    if compiler.get("strippath") == "true":
        raise InputError("files whose path it strips cannot be found from another folder")
    return tuple(key for key in element.attributes if key.startswith("file"))


def directives(target_file: Path, name: str, spacecraft: Spacecraft | None) -> str:
    """Return Drake model directives that add the target, and the spacecraft that holds it."""
    target = {"add_model": {"name": name, "file": f"file://{target_file.resolve()}"}}
    items: list[dict] = [target]
    if spacecraft is not None:
        file = f"file://{spacecraft.path}"  # a package:// URI would need a map of packages
        instance = spacecraft.plant.GetModelInstanceName(spacecraft.base.model_instance())
        known = (
            {"add_directives": {"file": file}}
            if spacecraft.path.name.endswith(FORMATS["drake-yaml"])
            else {"add_model": {"name": instance.partition("::")[0], "file": file}}
        )
        frame = spacecraft.capture_frame.scoped_name().get_full()
        weld = {"add_weld": {"parent": frame, "child": f"{name}::{name}"}}
        items = [known, target, weld]
    text = yaml.safe_dump(
        {"directives": items}, sort_keys=False, allow_unicode=True, width=float("inf")
    )
    return f"# {_WHAT}\n{text}"
