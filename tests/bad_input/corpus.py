"""Bad files of every kind, each with what the one line about it must say: where, and what."""

import io
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from model_parts import joint, link

from cpid_drake import InertialParameters, Motion, Spacecraft, shipped_scenario
from cpid_drake.dynamics.joint_motion import HalfCosine
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.identification.result import FORMAT
from cpid_drake.logs.formats import table_of

JOINTS = ("shoulder", "elbow", "wrist")
TARGET = InertialParameters(20.0, [0.3, 0.1, -0.1], [[2, 0.1, 0], [0.1, 3, 0.2], [0, 0.2, 4]])

Content = str | bytes | Callable[[], str | bytes]


@dataclass(frozen=True)
class Case:
    """One bad file."""

    name: str
    kind: str
    make: Callable[[Path], str]
    phrases: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.kind}-{self.name}"


def as_bytes(content: Content) -> bytes:
    content = content() if callable(content) else content
    return content.encode() if isinstance(content, str) else content


def file(name: str, content: Content, **others: Content) -> Callable[[Path], str]:
    """Return a maker of a file, and of others beside it (`a__b` is called a.b)."""

    def make(folder: Path) -> str:
        (folder / name).write_bytes(as_bytes(content))
        for other, text in others.items():
            (folder / other.replace("__", ".")).write_bytes(as_bytes(text))
        return name

    return make


def called(name: str) -> Callable[[Path], str]:
    """Return a maker that makes nothing: the name alone is what is bad."""
    return lambda folder: name


def made(name: str, how: Callable[[Path], object]) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        how(folder / name)
        return name

    return make


# -- what is all right ----------------------------------------------------------------------------


def urdf(hand: str = link("hand"), rest: str = "", head: str = "") -> str:
    """Return a base with an arm of three joints; `hand` is its last link, in line 5."""
    links = link("bus", 200, ixx=20.0, iyy=30.0, izz=40.0), link("upper"), link("fore"), hand
    joints = (
        joint("shoulder", "bus", "upper", axis="0 0 1"),
        joint("elbow", "upper", "fore", axis="0 1 0"),
        joint("wrist", "fore", "hand", axis="1 0 0"),
    )
    return "\n".join([f'{head}<robot name="craft">', *links, *joints, rest, "</robot>\n"])


def sdf(mass: object = 10, inner: str = "", axis: str = "0 0 1") -> str:
    return f"""<sdf version="1.9"><model name="craft">
<link name="bus"><inertial><mass>200</mass></inertial></link>
<link name="hand"><inertial><mass>{mass}</mass></inertial></link>
<joint name="wrist" type="revolute"><parent>bus</parent><child>hand</child>
<axis><xyz>{axis}</xyz></axis></joint>{inner}</model></sdf>
"""


def mjcf(mass: object = 10, rest: str = "", kind: str = "hinge") -> str:
    return f"""<mujoco model="craft">{rest}<worldbody><body name="bus"><freejoint/>
<inertial pos="0 0 0" mass="200" diaginertia="1 1 1"/>
<body name="hand"><joint name="wrist" type="{kind}"/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body></body></worldbody></mujoco>
"""


@cache
def motion() -> Motion:
    """Return 101 exact samples of an arm that holds `TARGET`, over 10 s."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "arm.urdf")
        path.write_text(urdf())
        craft = Spacecraft(path, base="bus", capture_frame="hand")
    joints = HalfCosine(np.array([0.0, 0.5, -0.3]), np.array([1.5, -0.9, 1.2]), 10.0)
    time = np.linspace(0.0, 10.0, 101)
    base = propagate(craft.tree, joints, TARGET.to_standard_vector(), time)
    return base.to_motion(craft.joint_names, time, joints)


def cells() -> list[list[str]]:
    """Return the good CSV file as cells, its header first."""
    columns, values = table_of(motion())
    return [columns, *([repr(value) for value in row] for row in values.tolist())]


def csv(change: Callable[[list[list[str]]], object] | None = None, between: str = ",") -> str:
    """Return the good CSV file, changed in its cells."""
    rows = cells()
    if change is not None:
        rows = change(rows) or rows
    return "".join(between.join(row) + "\n" for row in rows)


def write_good(folder: Path) -> None:
    """Write a model, `arm.urdf`, and a log of it, `log.csv`."""
    (folder / "arm.urdf").write_text(urdf())
    (folder / "log.csv").write_text(csv())


# -- telemetry ------------------------------------------------------------------------------------


def put(line: int, column: str, text: str) -> Callable[[], str]:
    """Return the CSV file with one cell changed; the header is line 1."""

    def change(rows: list[list[str]]) -> None:
        rows[line - 1][rows[0].index(column)] = text

    return lambda: csv(change)


def million_rows() -> str:
    """Return a million good lines and one that is none."""
    header = "time,qw,qx,qy,qz,q:shoulder,q:elbow,q:wrist"
    lines = [f"{k / 100},1,0,0,0,0.5,0,0" for k in range(1_000_000)]
    return "\n".join([header, *lines, "10000,1,0,0,0,1e,0,0"])


def arrays(**changes: object) -> dict[str, object]:
    columns, values = table_of(motion())
    found = dict(zip(columns, values.T)) | changes
    return {name: array for name, array in found.items() if array is not None}


def parquet(**changes: object) -> Callable[[], bytes]:
    def make() -> bytes:
        import pyarrow
        import pyarrow.parquet

        stream = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.table(arrays(**changes)), stream)
        return stream.getvalue()

    return make


TELEMETRY = {
    # Not a text, or not this text.
    "binary": (file("t.csv", bytes(range(256)) * 40), "line 1 holds binary data"),
    # The header.
    "long_line": (file("t.csv", lambda: csv() + "1" * 3_000_000), "line 103 is longer than"),
    # Separators and quotes.
    "short_row": (file("t.csv", lambda: csv(lambda r: r[8].pop() and None)), "line 9: 19 cells"),
    # Cells.
    "text": (file("t.csv", put(4, "vx", "fast")), "line 4, column 'vx'", "'fast'"),
    "million_rows": (file("t.csv", million_rows), "line 1000002, column 'q:shoulder': '1e'"),
    # Parquet.
    "parquet_text": (
        file("t.parquet", parquet(x=np.full(len(motion()), "fast"))),
        "t.parquet: the column 'x' must hold numbers, not string",
    ),
    "parquet_empty": (file("t.parquet", ""), "t.parquet: not a Parquet file"),
    # Bags.
    "mcap_text": (file("t.mcap", "no bag"), "t.mcap: not a ROS bag"),
    # No file, or another one.
    "missing": (called("t.csv"), "t.csv: no such file"),
    "fifo": (made("t.csv", os.mkfifo), "t.csv: not a file"),
    "device": (called("/dev/zero"), "/dev/zero: not a file"),
    "line_end_in_name": (called("t\nt.csv"), "t t.csv: no such file"),
    "long_name": (called("t" * 5000 + ".csv"), "too long"),
}


# -- models ---------------------------------------------------------------------------------------

ENTITIES = "<!DOCTYPE r [<!ENTITY a 'ha'>" + "".join(
    f"<!ENTITY {b} '{f'&{a};' * 10}'>" for a, b in zip("abcdefghi", "bcdefghij")
)


def directives(*entries: str, name: str = "m.dmd.yaml") -> Callable[[Path], str]:
    """Return a maker of model directives; FOLDER in them is the URI of the file's folder."""

    def make(folder: Path) -> str:
        text = "directives:\n" + "".join(f"- {entry}\n" for entry in entries)
        (folder / name).write_text(text.replace("FOLDER", f"file://{folder}"))
        return name

    return make


def together(*makers: Callable[[Path], str]) -> Callable[[Path], str]:
    """Return a maker of several files; the first is the one to read."""
    return lambda folder: [make(folder) for make in makers][0]  # noqa: RUF015 all are made


def including(name: str, text: str) -> Callable[[Path], str]:
    """Return a maker of a file in which FOLDER is its folder's URI."""

    def make(folder: Path) -> str:
        (folder / name).write_text(text.replace("FOLDER", f"file://{folder}"))
        return name

    return make


def rebuilt(old: str, new: str) -> Callable[[], str]:
    """Return the good URDF with a text replaced where it stands first."""

    def make() -> str:
        assert old in urdf()
        return urdf().replace(old, new, 1)

    return make


HAND = "m.urdf: line 5: "
WORLD = "<link name='world'/>" + joint("w", "world", "bus", kind="fixed")
MODELS = {
    # Not a model.
    "empty": (file("m.urdf", ""), "m.urdf: the file is empty"),
    "cut_off": (file("m.urdf", urdf()[:-30]), "m.urdf: line 8, column", "not XML"),
    "fifo": (made("m.urdf", os.mkfifo), "m.urdf: not a file"),
    # Bombs and loops.
    "billion_laughs": (
        file("m.urdf", urdf(head=ENTITIES + "]>")),
        "m.urdf: the entity &a;",
    ),
    "deep": (file("m.urdf", "<robot>" + "<link>" * 200_000), "not XML"),
    "directives_of_themselves": (
        directives("add_directives: {file: FOLDER/m.dmd.yaml}"),
        "m.dmd.yaml: the file includes itself",
    ),
    "directives_that_double": (
        together(
            *(
                directives(*[f"add_directives: {{file: FOLDER/{k + 1}.dmd.yaml}}"] * 2, name=name)
                for k, name in enumerate(["m.dmd.yaml", *(f"{k}.dmd.yaml" for k in range(1, 40))])
            )
        ),
        "more than 1000 includes",
    ),
    "directives_of_what_would_be_downloaded": (
        directives("add_model: {name: a, file: 'package://drake_models/a.urdf'}"),
        "unknown package 'drake_models'",
    ),
    "directives_of_a_bad_model": (
        together(
            directives("add_model: {name: a, file: FOLDER/o.urdf}"),
            file("o.urdf", urdf(link("hand", "1,5"))),
        ),
        "m.dmd.yaml: ",
        "o.urdf: line 5: ",
    ),
    "sdf_of_itself": (
        including("m.sdf", sdf(inner="<include><uri>FOLDER/m.sdf</uri></include>")),
        "m.sdf: the file includes itself",
    ),
    "mjcf_of_itself": (
        file("m.xml", mjcf(rest='<include file="m.xml"/>')),
        "m.xml: the file includes itself",
    ),
    # Numbers.
    "mass_comma": (file("m.urdf", urdf(link("hand", "1,5"))), HAND, "1,5 is not a"),
    "inertia_misspelt": (file("m.urdf", rebuilt("ixx", "Ixx")), "line 2", "no attribute 'ixx'"),
    # Structure.
    "joint_type": (file("m.urdf", rebuilt('"revolute"', '"hinge"')), "line 6", "'hinge'"),
    "loop": (file("m.urdf", urdf(rest=joint("j", "hand", "bus"))), "m.urdf: ", "loop"),
    "mimic_of_nothing": (
        file("m.urdf", rebuilt('link="upper"/>', 'link="upper"/><mimic joint="thumb"/>')),
        "joint 'shoulder' follows 'thumb' (mimic), and there is no such joint",
    ),
    "mimic_of_itself": (
        file("m.urdf", rebuilt('link="upper"/>', 'link="upper"/><mimic joint="shoulder"/>')),
        "joint 'shoulder' follows itself",
    ),
    "mimic_in_degrees": (
        file(
            "m.urdf",
            rebuilt('link="upper"/>', 'link="upper"/><mimic joint="wrist" offset="3 deg"/>'),
        ),
        "line 6: <mimic offset>: 3 deg is not a finite number",
    ),
    "two_roots": (file("m.urdf", urdf(rest=link("loose"))), "not connected", "loose"),
    "welded_at_both_ends": (
        file("m.urdf", urdf(rest=WORLD + joint("v", "world", "hand", kind="fixed"))),
        "m.urdf: base 'bus' does not float freely: joint 'v'",
    ),
    "on_a_rail": (
        file("m.urdf", urdf(rest=WORLD.replace("fixed", "prismatic"))),
        "base 'bus' does not float freely: joint 'w'",
    ),
    "beside_a_table": (
        file("m.urdf", urdf(rest=WORLD + link("table") + joint("t", "world", "table", "fixed"))),
        "not connected to the base 'bus': table",
    ),
    "no_base": (file("m.urdf", urdf().replace("bus", "body")), "no RigidBody named 'bus'", "body"),
}


# -- scenarios and sensors ------------------------------------------------------------------------


def scenario(old: str = "", new: str = "") -> Callable[[], str]:
    """Return the paper's scenario with a text replaced."""

    def make() -> str:
        text = shipped_scenario("paper").read_text()
        assert old in text
        return text.replace(old, new, 1)

    return make


def added(text: str) -> Callable[[], str]:
    return lambda: f"{scenario()()}{text}\n"


YAML = {
    "empty": ("", "must be a mapping"),
    "tab": ("spacecraft:\n\tmodel: a\n", "line 2, column 1"),
    "deep": ("[" * 100_000, "nested too deeply"),
    "alias": ("a: &a [1]\nb: *a\n", "line 2", "aliases are not read: write the value again"),
    "python_object": ("a: !!python/object/apply:os.system ['touch owned']\n", "line 1"),
    "unknown_key": ("spacecarft: {}\n", "unknown key 'spacecarft'"),
    "large": ("#" * 2_000_000, "larger than 1 MB"),
}


def paper_line(text: str) -> str:
    """Say in which line of the paper's scenario a text is."""
    before, found, _ = shipped_scenario("paper").read_text().partition(text)
    assert found
    return f"line {before.count(chr(10)) + 1}"


MASS = "mass: 100.0"
PRIOR = "{mass: 5, p_CTcm_C: [0.4, 0, 0], I_TTcm_C: [[2, 0, 0], [0, 2, 0], [0, 0, 2]], sigma: 0.5}"
SCENARIOS = {
    "mass_negative": (scenario(MASS, "mass: -100.0"), "target: not a rigid body: the mass -100 kg"),
    "mass_twice": (
        scenario(MASS, f"{MASS}\n  {MASS}"),
        f"{paper_line('  p_CTcm_C')}, column 3: the key 'mass' is given twice",
    ),
    "mass_misspelt": (scenario(MASS, "mas: 100.0"), "'target.mas'; did you mean 'mass'?"),
    "com_in_millimetres": (scenario("[0.4330127, 0.0, 0.0]", "[433.0, 0.0, 0.0]"), "millimetres"),
    "joint_misspelt": (
        scenario("capture_arm_joint1: 0.2", "capture_arm_jiont1: 0.2"),
        "joint_motion.initial: no joint 'capture_arm_jiont1'; did you mean 'capture_arm_joint1'?",
    ),
    "joint_in_degrees": (
        scenario("capture_arm_joint1: -0.8", "capture_arm_joint1: -46"),
        "joint_motion.final: capture_arm_joint1 = -46 is outside [-3.1, 3.1]; angles are in",
    ),
    "com_of_two": (
        scenario("[0.4330127, 0.0, 0.0]", "[0.43, 0.0]"),
        "target.p_CTcm_C must be a list of 3 numbers, not [0.43, 0.0]",
    ),
    "com_nan": (
        scenario("[0.4330127, 0.0, 0.0]", "[.nan, 0.0, 0.0]"),
        "CTcm_C must be finite numbers",
    ),
    "key_of_a_tag": (
        scenario("joint_motion:\n", "joint_motion: !MultiSineMotion\n  amps: {}\n"),
        "unknown key 'joint_motion.amps'; did you mean 'ramp'? choose from duration, ramp, freq",
    ),
    "tag_misspelt": (
        scenario("joint_motion:", "joint_motion: !MultiSinMotion"),
        "joint_motion: unknown tag !MultiSinMotion; did you mean '!MultiSineMotion'?",
    ),
    "many_logged": (scenario("log_period: 0.0625", "log_period: 1e-7"), "more than 1000000 times"),
    "suite_and_list": (
        added("sensors: {suite: flight, explicit: {encoders: {}}}"),
        "sensors: suite and explicit: give one of the two",
    ),
    "rate_negative": (
        added("sensors: {explicit: {encoders: {rate: -1.0}}}"),
        "sensors.explicit.encoders.rate must be greater than or equal to 0.001, not -1.0",
    ),
    "burn_late": (
        scenario("log_period", "burns: [{time: 10.5, duration: 1.0}]\n  log_period"),
        "simulation.burns[0].time must be within the simulation's duration, 10 s, not 10.5",
    ),
    "estimator_unknown": (scenario("rows: eq18", "estimator: guess"), "must be 'least_squ"),
    "sensors_missing": (scenario("rows: eq18", "estimator: recursive_fit"), "needs sensors; give"),
    "prior_unused": (
        scenario("rows: eq18", f"prior: {PRIOR}"),
        "identification.prior: least_squares uses no prior",
    ),
    "tab": (scenario("  base", "\tbase"), f"{paper_line('  base')}, column 1"),
    "million_samples": (scenario("period: 1.0", "period: 1.0e-9"), "period"),
}

SENSORS = {
    "sigma_nan": ("encoders: {sigma: .nan}", "encoders.sigma"),
    "sigma_unit": (
        "encoders: {sigma: 1 mm}",
        "encoders.sigma must be a valid number, not '1 mm'; numbers are written without units",
    ),
    "misspelt": ("encoder: {bits: 20}", "unknown key 'encoder'; did you mean 'encoders'?"),
}


# -- results --------------------------------------------------------------------------------------


def result(**changes: object) -> str:
    ten = TARGET.to_vector().tolist()
    document = {
        "format": FORMAT,
        "parameters": ten,
        "covariance": np.eye(10).tolist(),
        "intervals": [[value - 2, value + 2] for value in ten],
        "nearest": ten,
        "rank": 10,
        "singular_values": 10 * [1.0],
        "sample_count": 20,
        "estimator": "least_squares",
        "rows": "standard",
    }
    return json.dumps({k: v for k, v in (document | changes).items() if v is not ...})


RESULTS = {
    "key_twice": ('{"mass": 1, "mass": 2}', "'mass' is given twice"),
    "no_parameters": (result(parameters=...), "parameters is missing"),
    "nan": (result(parameters=10 * [float("nan")]), "NaN"),
    "text": (result(condition="20 kg"), "condition must be a valid number, not '20 kg'"),
    "rank_11": (result(rank=11), "rank must be less than or equal to 10, not 11"),
    "negative_mass": (
        result(nearest=[-1, 0, 0, 0, 1, 1, 1, 0, 0, 0]),
        "nearest: no rigid body",
    ),
}
EXPORTS = {
    "not_consistent": (result(nearest=None), "no rigid body is near the estimate"),
}

# -- all ------------------------------------------------------------------------------------------


def cases() -> list[Case]:
    found = [Case(name, "telemetry", make, says) for name, (make, *says) in TELEMETRY.items()]
    found += [Case(name, "model", make, says) for name, (make, *says) in MODELS.items()]
    found += [
        Case(name, "scenario", file("s.yaml", content), ("s.yaml: ", *says))
        for name, (content, *says) in YAML.items()
    ]
    for kind, texts in (("scenario", SCENARIOS), ("sensors", SENSORS)):
        found += [
            Case(f"{name}_in_it", kind, file("s.yaml", content), ("s.yaml: ", *says))
            for name, (content, *says) in texts.items()
        ]
    for kind, texts in (("result", RESULTS), ("export", EXPORTS)):
        found += [
            Case(name, kind, file("r.json", content), ("r.json: ", *says))
            for name, (content, *says) in texts.items()
        ]
    return [replace(case, phrases=tuple(case.phrases)) for case in found]
