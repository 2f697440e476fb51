"""Parts of models in URDF, whose inertias and frames are skewed unless they are given."""

INERTIA = {"ixx": 2.0, "iyy": 3.0, "izz": 4.0, "ixy": 0.1, "ixz": -0.2, "iyz": 0.3}
BALANCED = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}


def link(name, mass=10.0, inner="", com="0.1 -0.2 0.3", **inertia) -> str:
    moments = " ".join(f'{key}="{value}"' for key, value in (INERTIA | inertia).items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}" rpy="0.2 0.1 -0.3"/>'
        f'<mass value="{mass}"/><inertia {moments}/></inertial>{inner}</link>'
    )


def joint(
    name,
    parent,
    child,
    kind="revolute",
    axis="0.6 0 0.8",
    xyz="0.5 -0.1 0.2",
    rpy="0.3 -0.2 0.4",
    limits=(-2, 2.5),
) -> str:
    low, high = limits
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" effort="10" velocity="0.7"/></joint>'
    )


def urdf(*parts, name="mine") -> str:
    return f'<?xml version="1.0"?><robot name="{name}">{"".join(parts)}</robot>'
