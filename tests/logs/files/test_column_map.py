"""A log in another convention, read with a map of its columns, is the log in the house format."""

from dataclasses import fields, is_dataclass, replace
from itertools import product

import numpy as np
import pytest
import yaml
from processes import ROOT
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, from_columns, read_log
from cpid_drake.logs.column_map import AttitudeColumns, ColumnMap, load_column_map
from cpid_drake.logs.formats import FORMATS, inspect_log
from cpid_drake.sensors.sensors import SENSORS

POINT = np.array([0.3, -0.2, 0.5])


@pytest.fixture
def motion(random_motion):
    """Return exact telemetry of 40 samples, 0.1 s apart."""
    return replace(random_motion(40, 3), time=np.arange(40) * 0.1)


def written(folder, columns, ending="csv"):
    """Write columns by name to a file of this ending, and return its path."""
    path = folder / f"log.{ending}"
    write = FORMATS[path.suffix][1]
    values = np.stack([np.asarray(column, dtype=float) for column in columns.values()], axis=1)
    write(path, list(columns), values)
    return path


def house(motion):
    """Return the columns of the house format by name."""
    columns = {"time": motion.time}
    for names, values in (
        (("qw", "qx", "qy", "qz"), motion.quaternion_WB),
        (("x", "y", "z"), motion.p_WB),
        (("vx", "vy", "vz"), motion.v_WB),
        (("wx", "wy", "wz"), motion.w_WB),
        ([f"q:{joint}" for joint in motion.joint_names], motion.q),
        ([f"qd:{joint}" for joint in motion.joint_names], motion.qdot),
    ):
        columns.update(zip(names, values.T))
    return columns


def mapped(folder, text):
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def in_B(motion, vectors):
    return np.einsum("nji,nj->ni", motion.R_WB, vectors)


def assert_reads_as(log, motion, tolerance=1e-12):
    """Assert that measurements are this motion."""
    for name in ("attitude", "position", "velocity", "encoders", "joint_rates", "gyro"):
        ideal = SENSORS[name].ideal(motion)
        value = log[name].value
        if name == "attitude":  # q and −q are the same attitude
            value = value * np.sign(np.sum(value * ideal, axis=1))[:, None]
        np.testing.assert_allclose(value, ideal, rtol=0, atol=tolerance)
        np.testing.assert_allclose(log[name].time, motion.time, rtol=0, atol=1e-9)
    assert log.joint_names == motion.joint_names


def attitude_of(motion, **conventions):
    R_WB = Rotation.from_quat(motion.quaternion_WB, scalar_first=True)
    return {
        "xyzw": R_WB.as_quat(),
        "R_BW": R_WB.inv().as_quat(scalar_first=True),
        "XYZ": R_WB.as_euler("XYZ"),
    }


@pytest.mark.parametrize(
    ("kind", "entry"),
    [
        ("xyzw", "order: xyzw"),
        ("R_BW", "direction: R_BW"),
        ("XYZ", "order: XYZ"),
    ],
)
def test_an_attitude_in_any_convention_is_read(tmp_path, motion, kind, entry):
    columns = house(motion)
    for name in ("qw", "qx", "qy", "qz"):
        columns.pop(name)
    values = attitude_of(motion)[kind].T
    columns.update({f"a{k}": column for k, column in enumerate(values)})
    names = ", ".join(f"a{k}" for k in range(len(values)))
    text = f"attitude: {{columns: [{names}], {entry.strip('{}')}}}"
    log = read_log(written(tmp_path, columns), columns=mapped(tmp_path, text))
    assert_reads_as(log, motion)


def turn(axis, angle):
    """Return the matrix of a rotation about a unit axis, by Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def assert_attitude_is(R_WB, entries, **conventions):
    """Assert that a log with these entries of the attitude is read as R_WB."""
    names = [f"a{k}" for k in range(len(entries[0]))]
    columns = {"time": np.arange(len(entries)), **dict(zip(names, np.transpose(entries)))}
    given = ColumnMap(attitude=AttitudeColumns(names, **conventions))
    log = from_columns(columns | {"q:a": np.zeros(len(entries))}, given)
    found = Rotation.from_quat(log.attitude.value, scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, R_WB, rtol=0, atol=1e-12)


AXES = dict(zip("xyz", np.eye(3)))
UNITS = {"rad": 1.0, "deg": 180 / np.pi, "mrad": 1000.0}
SEQUENCES = ["".join(s) for s in product("xyz", repeat=3) if s[0] != s[1] != s[2]]


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("direction", ["R_WB", "R_BW"])
def test_euler_angles_of_every_sequence_are_read(unit, direction):
    """Those about axes of the body turn one after the other to the right, others to the left."""
    angles = np.random.default_rng(5).uniform(-7.0, 7.0, (20, 3))
    for sequence in SEQUENCES:
        R = np.array([[turn(AXES[n], a) for n, a in zip(sequence, row)] for row in angles])
        for order, factors in ((sequence.upper(), (0, 1, 2)), (sequence, (2, 1, 0))):
            logged = np.array([np.linalg.multi_dot(each[[*factors]]) for each in R])
            R_WB = logged if direction == "R_WB" else np.swapaxes(logged, 1, 2)
            entries = angles * UNITS[unit]
            assert_attitude_is(R_WB, entries, order=order, unit=unit, direction=direction)


@pytest.mark.parametrize("unit", UNITS)
def test_rotation_vectors_are_read_in_every_unit(unit):
    vectors = np.random.default_rng(6).uniform(-4.0, 4.0, (20, 3))
    lengths = np.linalg.norm(vectors, axis=1)
    R_WB = np.array([turn(v / n, n) for v, n in zip(vectors, lengths)])
    assert_attitude_is(R_WB, vectors * UNITS[unit], order="rotation_vector", unit=unit)


@pytest.mark.parametrize("switches", [True, False])
def test_modified_rodrigues_parameters_are_read_with_their_shadow_set(switches):
    """The shadow set is that of the angle less a whole turn, so that it is never beyond 180°."""
    axis, angles = np.array([2.0, -3.0, 6.0]) / 7, np.linspace(0.0, 1.9 * np.pi, 60)
    angles = 2 * angles if switches else angles
    shown = (angles + np.pi) % (2 * np.pi) - np.pi if switches else angles
    R_WB = np.array([turn(axis, angle) for angle in angles])
    assert_attitude_is(R_WB, np.outer(np.tan(shown / 4), axis), order="mrp")


def test_the_parameters_of_basilisk_are_those_of_the_map():
    """Its matrix [BN], as Schaub and Junkins write it, takes vectors of N to B: it is R_BW."""
    sigma = np.random.default_rng(7).uniform(-1.0, 1.0, (20, 3))
    R_BN = []
    for x, y, z in sigma:
        S, square = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), x**2 + y**2 + z**2
        R_BN.append(np.eye(3) + (8 * S @ S - 4 * (1 - square) * S) / (1 + square) ** 2)
    assert_attitude_is(np.swapaxes(R_BN, 1, 2), sigma, order="mrp")


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_names_units_frames_and_a_marker_are_converted_in_every_format(tmp_path, motion, ending):
    arm = np.einsum("nij,j->ni", motion.R_WB, POINT)
    columns = {"stamp": motion.time * 1e9 + 1.7e18}
    for names, values in (
        ("abcd", motion.quaternion_WB),
        (("TX", "TY", "TZ"), (motion.p_WB + arm) * 1000),
        (("u", "v", "w"), in_B(motion, motion.v_WB + np.cross(motion.w_WB, arm)) * 100),
        (("wx", "wy", "wz"), np.degrees(in_B(motion, motion.w_WB))),
        ([f"arm/{joint}.pos" for joint in motion.joint_names], np.degrees(motion.q)),
        ([f"arm/{joint}.vel" for joint in motion.joint_names], motion.qdot * 30 / np.pi),
    ):
        columns.update(zip(names, values.T))
    columns["arm/finger.pos"] = np.arange(40)
    text = f"""
        time: {{column: stamp, unit: ns, epoch: 1.7e18}}
        attitude: {{columns: [a, b, c, d]}}
        position: {{columns: [TX, TY, TZ], unit: mm, point_B: {POINT.tolist()}}}
        velocity: {{columns: [u, v, w], unit: cm/s, frame: body, point_B: {POINT.tolist()}}}
        angular_velocity: {{unit: deg/s, frame: body}}
        joint_positions: {{prefix: arm/, suffix: .pos, unit: deg}}
        joint_rates: {{prefix: arm/, suffix: .vel, unit: rpm}}
        ignore_joints: [finger]
    """
    file, columns_file = written(tmp_path, columns, ending), mapped(tmp_path, text)
    found = inspect_log(file, columns=columns_file)
    moved = found.log
    # 1.7e18 ns has a resolution of 256 ns.
    np.testing.assert_allclose(moved.gyro.time, motion.time, rtol=0, atol=2e-7)
    for name in ("attitude", "position", "velocity", "encoders", "joint_rates", "gyro"):
        ideal = SENSORS[name].ideal(motion)
        np.testing.assert_allclose(moved[name].value, ideal, rtol=0, atol=1e-12)
    assert "arm/finger.pos" in found.ignored


def test_frames_and_stamps_of_two_columns_are_times(tmp_path, motion):
    columns = house(motion)
    columns["time"] = np.arange(40) + 7
    text = "time: {unit: frame, rate: 10, epoch: 7}"
    log = read_log(written(tmp_path, columns), columns=mapped(tmp_path, text))
    np.testing.assert_allclose(log.gyro.time, motion.time, rtol=0, atol=1e-12)
    columns["time"] = np.floor(motion.time) + 1.7e9
    columns["nanosec"] = np.round((motion.time % 1) * 1e9)
    text = "time: {epoch: 1.7e9, nanoseconds: nanosec}"
    log = read_log(written(tmp_path, columns), columns=mapped(tmp_path, text))
    np.testing.assert_allclose(log.gyro.time, motion.time, rtol=0, atol=1e-12)


def test_the_map_in_the_documentation_has_every_key(tmp_path):
    page = (ROOT / "docs/how-to/columns.md").read_text()
    text = page.split("```yaml\n")[1].split("```")[0]
    column_map = load_column_map(mapped(tmp_path, text.replace("unit: ns #", "unit: s #")))
    given = yaml.safe_load(text)
    for entry in fields(ColumnMap):
        section = getattr(column_map, entry.name)
        assert entry.name in given
        if is_dataclass(section) and entry.name not in ("time", "joint_rates", "velocity"):
            assert {key.name for key in fields(section)} == given[entry.name].keys()
    assert column_map.position.point_B.tolist() == [0.1, 0.0, 0.2]


def test_samples_that_are_logged_in_part_are_counted_whatever_their_convention(tmp_path, motion):
    columns = house(motion)
    columns["vy"] = np.where(np.arange(40) == 7, np.nan, columns["vy"])
    columns["qw"] = np.where(np.arange(40) < 3, np.nan, columns["qw"])
    for name in ("wx", "wy", "wz"):  # not logged at all on most rows: absent, not incomplete
        columns[name] = np.where(np.arange(40) % 4, np.nan, columns[name])
    text = "{velocity: {frame: body}, position: {point_B: [1, 0, 0]}}"
    found = inspect_log(written(tmp_path, columns), columns=mapped(tmp_path, text))
    assert found.partial == {"attitude": 3, "gyro": 1, "position": 3, "velocity": 4}
    assert (len(found.log.velocity), len(found.log.position)) == (36, 37)


def test_angles_that_are_logged_in_part_are_counted(tmp_path, motion):
    columns = house(motion)
    angles = attitude_of(motion)["XYZ"]
    angles[4:6, 1] = np.nan
    for name in ("qw", "qx", "qy", "qz", "wx", "wy", "wz"):
        columns.pop(name)
    columns.update(zip("abc", angles.T))
    text = "attitude: {columns: [a, b, c], order: XYZ}"
    found = inspect_log(written(tmp_path, columns), columns=mapped(tmp_path, text))
    assert found.partial == {"attitude": 2}


def test_joints_that_the_spacecraft_lacks_do_not_make_samples_incomplete(tmp_path, motion):
    columns = house(motion)
    columns["q:finger"] = np.full(40, np.nan)  # without a rate, and at its own times
    file = written(tmp_path, columns)
    with pytest.raises(InputError, match="no 'qd:finger'"):
        read_log(file)
    found = inspect_log(file, joints=motion.joint_names)
    assert found.left_out_joints == ("finger",)
    np.testing.assert_array_equal(found.log.encoders.value, motion.q)


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("positon: {unit: mm}", "map.yaml: unknown key 'positon'; did you mean 'position'"),
        ("position: {unit: mn}", "map.yaml: position.unit must be 'm', 'cm', 'mm'"),
        ("position: {columns: [x, y]}", "map.yaml: position.columns must name 3, not 2"),
        ("{attitude: {order: yaw}, position: {columns: [a, b, c]}}", "must name 2, not 3"),
        ("attitude: {order: ZYX}", "map.yaml: attitude.columns must name the three of ZYX"),
        (
            "attitude: {order: zYx}",
            "attitude.order must be 'wxyz', .*'XYZ', .* not 'zYx'",
        ),
        ("attitude: {order: mrp, columns: [a, b, c], unit: deg}", "the order mrp has none"),
        ("time: {unit: frame}", r"time.rate \(frames per second\) and time.unit: frame go togeth"),
        ("time: {rate: 10.0}", r"time.rate \(frames per second\)"),
        ("time: {unit: ms, nanoseconds: n}", "time.nanoseconds are added to a time of the unit s"),
        ("position: {columns: [x, x, z]}", "the column 'x' is named 2 times"),
        ("{position: {columns: [a, b, c]}, ignore_columns: [a]}", "'a' is named, and ignored too"),
    ],
)
def test_a_map_that_contradicts_itself_is_refused(tmp_path, text, phrase):
    with pytest.raises(InputError, match=phrase):
        load_column_map(mapped(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        (
            "position: {columns: [X, y, z]}",
            r"no column 'X', which .*map.yaml names; the columns are time, qw,",
        ),
        ("time: {column: t}", r"no column 't', which .*map.yaml names"),
        ("joint_positions: {columns: {a: angle}}", r"no column 'angle', which"),
        ("joint_positions: {prefix: j}", r"no joint positions"),
    ],
)
def test_a_map_of_another_log_is_refused(tmp_path, motion, text, phrase):
    file = written(tmp_path, house(motion))
    with pytest.raises(InputError, match=phrase):
        read_log(file, columns=mapped(tmp_path, text))


@pytest.mark.parametrize("between", [";", "   "])
def test_a_text_file_without_a_header_is_read_by_the_numbers_of_its_columns(
    tmp_path, motion, between
):
    columns = house(motion)
    values = np.stack(list(columns.values()), axis=1)
    file = tmp_path / "log.csv"
    file.write_text("\n".join(between.join(map(repr, row)) for row in values.tolist()))
    with pytest.raises(InputError, match=r"line 1 holds numbers; .* by their numbers"):
        read_log(file)
    numbers = dict(zip(columns, map(str, range(1, len(columns) + 1))))
    given = ColumnMap()
    given.time.column = numbers["time"]
    given.attitude.columns = [numbers[name] for name in ("qw", "qx", "qy", "qz")]
    given.position.columns = [numbers[name] for name in "xyz"]
    given.velocity.columns = [numbers[name] for name in ("vx", "vy", "vz")]
    given.angular_velocity.columns = [numbers[name] for name in ("wx", "wy", "wz")]
    given.angular_velocity.frame = "world"
    for section, prefix in ((given.joint_positions, "q:"), (given.joint_rates, "qd:")):
        section.columns = {joint: numbers[prefix + joint] for joint in motion.joint_names}
    assert_reads_as(read_log(file, columns=given), motion)


def test_columns_in_memory_are_read_like_a_file(motion):
    """As from a MATLAB file or a data frame."""
    assert_reads_as(from_columns(house(motion)), motion)
    with pytest.raises(InputError, match="row 3, column 'x': 'inf' is not a finite number"):
        from_columns(house(motion) | {"x": np.where(np.arange(40) == 3, np.inf, 0.0)})
    with pytest.raises(InputError, match="the same length"):
        from_columns(house(motion) | {"x": np.zeros(3)})


@pytest.mark.parametrize(("unit", "start"), [("ns", "2026-01-01"), ("us", None), ("ms", None)])
def test_dates_and_durations_in_memory_are_times_in_seconds(motion, unit, start):
    """Their numbers alone would be nanoseconds, or milliseconds."""
    ticks = np.round(motion.time * {"ns": 1e9, "us": 1e6, "ms": 1e3}[unit])
    times = ticks.astype(f"timedelta64[{unit}]") + (np.datetime64(start) if start else 0)
    found = from_columns(house(motion) | {"time": times})
    np.testing.assert_allclose(found.encoders.time, motion.time, atol=1e-9)


def test_turned_sensors_reversed_and_constant_joints_are_read_as_the_model_says(motion):
    """The tracker is turned by 90° about z, the gyro mirrored in x, and one joint does not move."""
    *moving, still = motion.joint_names
    motion = replace(
        motion,
        q=np.hstack([motion.q[:, :-1], np.full((40, 1), 0.3)]),
        qdot=np.hstack([motion.qdot[:, :-1], np.zeros((40, 1))]),
    )
    R_BS = Rotation.from_euler("z", 90, degrees=True)
    columns = house(motion)
    attitude = Rotation.from_quat(motion.quaternion_WB, scalar_first=True) * R_BS
    for name, values in zip(("qw", "qx", "qy", "qz"), attitude.as_quat(scalar_first=True).T):
        columns[name] = values
    for name in ("wx", "wy", "wz"):
        del columns[name]
    for k, values in enumerate((in_B(motion, motion.w_WB) * [-1, 1, 1]).T):
        columns[f"bw{'xyz'[k]}"] = values
    for name in (f"q:{moving[0]}", f"qd:{moving[0]}"):
        columns[name] = -columns[name]
    del columns[f"q:{still}"], columns[f"qd:{still}"]
    given = ColumnMap(reversed_joints=[moving[0]])
    given.attitude.R_BS = R_BS.as_matrix()
    given.angular_velocity.R_BS = np.diag([-1.0, 1.0, 1.0])
    given.joint_positions.constant = {still: 0.3}
    assert_reads_as(from_columns(columns, given), motion, 1e-9)
    given.angular_velocity.R_BS = np.ones((3, 3))
    with pytest.raises(InputError, match=r"angular_velocity\.R_BS must be a rotation"):
        from_columns(columns, given)


def test_a_log_without_joint_columns_is_read_if_no_joint_moves(motion):
    columns = {name: values for name, values in house(motion).items() if not name.startswith("q")}
    columns |= dict(zip(("qw", "qx", "qy", "qz"), motion.quaternion_WB.T))
    given = ColumnMap()
    given.joint_positions.constant = dict.fromkeys(motion.joint_names, 0.1)
    read = from_columns(columns, given)
    np.testing.assert_array_equal(read.encoders.value, np.full((40, len(motion.joint_names)), 0.1))
