"""ROS bags: written with the package rosbags, read back; topics, frames, clocks, damage."""

from collections import Counter
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpid_drake import ColumnMap, InputError, read_log
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.logs.formats import inspect_log
from cpid_drake.logs.screening import screen
from cpid_drake.sensors.sensors import SENSORS

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the package rosbags")
rosbag1 = pytest.importorskip("rosbags.rosbag1")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
START = 1_763_737_800_123_456_789  # ns; as float seconds it would be off by up to 1.2e-7 s
STEP = 10_000_001  # ns
COUNT = 40
TYPES = {name.split("/")[-1]: STORE.types[name] for name in STORE.types if "/msg/" in name}


def header(nanoseconds: int, frame: str = "world"):
    seconds, rest = divmod(nanoseconds, 10**9)
    return TYPES["Header"](STORE.types["builtin_interfaces/msg/Time"](seconds, rest), frame)


def vector(values):
    return TYPES["Vector3"](*map(float, values))


def pose(telemetry, k):
    w, x, y, z = telemetry.quaternion_WB[k]
    return TYPES["Pose"](TYPES["Point"](*telemetry.p_WB[k]), TYPES["Quaternion"](x, y, z, w))


def odometry(telemetry, k, stamp, child="bus"):
    """As a ROS driver gives it: the twist is in the child frame."""
    R_BW = telemetry.R_WB[k].T
    twist = TYPES["Twist"](
        vector(R_BW @ telemetry.v_WB[k]),
        vector(R_BW @ telemetry.w_WB[k]),
    )
    none = np.zeros(36)
    posed = TYPES["PoseWithCovariance"](pose(telemetry, k), none)
    return TYPES["Odometry"](header(stamp), child, posed, TYPES["TwistWithCovariance"](twist, none))


def odometry_in_W(telemetry, k, stamp):
    """As some simulators give it: the twist is in the axes of the pose."""
    given = odometry(telemetry, k, stamp)
    twist = TYPES["Twist"](vector(telemetry.v_WB[k]), vector(telemetry.w_WB[k]))
    return TYPES["Odometry"](
        given.header,
        given.child_frame_id,
        given.pose,
        TYPES["TwistWithCovariance"](twist, np.zeros(36)),
    )


def stamped_pose(telemetry, k, stamp):
    return TYPES["PoseStamped"](header(stamp), pose(telemetry, k))


def imu(telemetry, k, stamp, oriented=True, w_error=0.0):
    known, unknown = np.zeros(9), np.array([-1.0] + 8 * [0.0])
    w, x, y, z = telemetry.quaternion_WB[k]
    return TYPES["Imu"](
        header(stamp, "bus"),
        TYPES["Quaternion"](x, y, z, w),
        known if oriented else unknown,
        vector(telemetry.R_WB[k].T @ telemetry.w_WB[k] + w_error),
        known,
        vector(np.zeros(3)),
        unknown,
    )


def joint_state(telemetry, k, stamp, order=None, rates=True):
    order = np.arange(len(telemetry.joint_names)) if order is None else order
    return TYPES["JointState"](
        header(stamp, ""),
        [telemetry.joint_names[j] for j in order],
        telemetry.q[k, order],
        telemetry.qdot[k, order] if rates else np.empty(0),
        np.empty(0),
    )


def stamps(count=COUNT):
    return [START + k * STEP for k in range(count)]


@pytest.fixture(scope="module")
def telemetry(zero_momentum_motion, skewed_target):
    return zero_momentum_motion(skewed_target, COUNT, 3)


@pytest.fixture
def write(tmp_path):
    """Return a function (topics, storage) -> bag, topics being lists of messages by name."""

    def make(topics: dict[str, list], storage="SQLITE3", received=None, empty=(), own=()) -> Path:
        folder = tmp_path / f"bag{len(list(tmp_path.iterdir()))}"
        plugin = rosbag2.StoragePlugin[storage]
        with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as writer:
            for topic, kind in empty:
                writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind, text in own:
                writer.add_connection(topic, kind, msgdef=text, rihs01="RIHS01_" + 64 * "0")
            for topic, messages in topics.items():
                kind = messages[0].__msgtype__
                connection = writer.add_connection(topic, kind, typestore=STORE)
                for k, message in enumerate(messages):
                    when = START + 5_000_000 + k * STEP if received is None else received[k]
                    writer.write(connection, when, STORE.serialize_cdr(message, kind))
        return folder

    return make


def series(make, telemetry, **options):
    return [make(telemetry, k, stamp, **options) for k, stamp in enumerate(stamps(len(telemetry)))]


def odometry_and_joints(telemetry):
    return {"/odom": series(odometry, telemetry), "/joints": series(joint_state, telemetry)}


def assert_equal(measurements, telemetry, sensors=SENSORS):
    assert measurements.joint_names == telemetry.joint_names
    for name in SENSORS:
        samples = getattr(measurements, name)
        if name not in sensors:
            assert len(samples) == 0
            continue
        expected = np.arange(len(telemetry)) * STEP / 1e9
        np.testing.assert_allclose(samples.time, expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(samples.value, SENSORS[name].ideal(telemetry), atol=1e-12)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_bag_gives_back_the_motion(write, telemetry, storage):
    bag = write(odometry_and_joints(telemetry), storage)
    assert_equal(read_log(bag), telemetry)
    (file,) = [file for file in bag.iterdir() if file.suffix in (".db3", ".mcap")]
    assert_equal(read_log(str(file)), telemetry)


def test_a_map_says_that_a_twist_is_in_the_world(write, telemetry):
    topics = {**odometry_and_joints(telemetry), "/odom": series(odometry_in_W, telemetry)}
    in_W = ColumnMap()
    in_W.velocity.frame = in_W.angular_velocity.frame = "world"
    assert_equal(read_log(write(topics), columns=in_W), telemetry)


def test_a_map_of_columns_serves_bags(write, telemetry, tmp_path):
    names = tuple(f"robot/{name}" for name in telemetry.joint_names)
    degrees = replace(telemetry, joint_names=names, q=np.degrees(telemetry.q))
    bag = write(
        {
            "/pose": series(stamped_pose, replace(telemetry, p_WB=telemetry.p_WB * 100)),
            "/joints": series(joint_state, degrees),
        }
    )
    columns = tmp_path / "map.yaml"
    columns.write_text(
        """
        position: {unit: cm}
        joint_positions: {prefix: "q:robot/", unit: deg}
        joint_rates: {prefix: "qd:robot/"}
        """
    )
    found = read_log(bag, columns=columns)
    assert_equal(found, telemetry, ("attitude", "position", "encoders", "joint_rates"))


def test_poses_give_attitude_and_position_only(write, telemetry):
    topics = {"/mocap": series(stamped_pose, telemetry), "/j": series(joint_state, telemetry)}
    joint_and_pose = ("attitude", "position", "encoders", "joint_rates")
    assert_equal(read_log(write(topics)), telemetry, joint_and_pose)


def test_thrust_is_read_from_the_topic_that_is_named(write, telemetry):
    """Another topic of this type can be that of a force sensor."""
    messages = [
        TYPES["WrenchStamped"](
            header(stamp, "bus"), TYPES["Wrench"](vector([k, 2.0, 3.0]), vector([4.0, 5.0, -k]))
        )
        for k, stamp in enumerate(stamps())
    ]
    bag = write({**odometry_and_joints(telemetry), "/thrusters": messages, "/wrist": messages[:5]})
    assert not len(read_log(bag).thrust)
    found = read_log(bag, topics={"thrust": "/thrusters"})
    assert_equal(found, telemetry)
    expected = [[4.0, 5.0, -k, k, 2.0, 3.0] for k in range(COUNT)]
    np.testing.assert_array_equal(found.thrust.value, expected)
    np.testing.assert_allclose(found.thrust.time, np.arange(COUNT) * STEP / 1e9, atol=1e-15)


def test_an_imu_gives_the_gyro_and_an_attitude_if_it_says_so(write, telemetry):
    joints = series(joint_state, telemetry, rates=False)
    bag = write({"/imu": series(imu, telemetry), "/j": joints})
    assert_equal(read_log(bag), telemetry, ("attitude", "gyro", "encoders"))
    bag = write({"/imu": series(imu, telemetry, oriented=False), "/j": joints})
    assert_equal(read_log(bag), telemetry, ("gyro", "encoders"))


def test_the_imu_is_the_gyro_beside_odometry_unless_it_is_left_out(write, telemetry):
    topics = odometry_and_joints(telemetry) | {"/imu": series(imu, telemetry, w_error=0.5)}
    bag = write(topics)
    gyro = SENSORS["gyro"].ideal(telemetry)
    measurements = read_log(bag)
    np.testing.assert_allclose(measurements.gyro.value, gyro + 0.5, atol=1e-12)
    np.testing.assert_allclose(measurements.attitude.value, telemetry.quaternion_WB, atol=1e-12)
    assert_equal(read_log(bag, topics={"imu": ""}), telemetry)


def test_joints_may_change_their_order_and_messages_may_be_late(write, telemetry):
    rng = np.random.default_rng(1)
    topics = odometry_and_joints(telemetry)
    for k in range(1, COUNT):
        order = rng.permutation(len(telemetry.joint_names))
        topics["/joints"][k] = joint_state(telemetry, k, stamps()[k], order=order)
    received = (START + STEP * (np.arange(COUNT) + rng.uniform(0, 20, COUNT))).astype(int)
    assert (np.diff(received) < 0).any()
    assert_equal(read_log(write(topics, received=received.tolist())), telemetry)


def test_an_attitude_that_is_none_takes_its_velocity_with_it(write, telemetry):
    topics = odometry_and_joints(telemetry)
    topics["/odom"][7].pose.pose.orientation = TYPES["Quaternion"](0.0, 0.0, 0.0, 0.0)
    found = inspect_log(write(topics))
    assert found.partial == {"attitude": 1, "velocity": 1}
    assert not found.problems
    assert len(found.log.position) == COUNT
    v_WB_B = rotate(np.swapaxes(telemetry.R_WB, 1, 2), telemetry.v_WB)
    assert np.abs(v_WB_B - telemetry.v_WB).max() > 0.1  # else the turn into W would not show
    others = np.delete(np.arange(COUNT), 7)
    velocity = found.log.velocity.value
    np.testing.assert_allclose(velocity, telemetry.v_WB[others], atol=1e-12)


def test_a_message_that_comes_twice_counts_once(write, telemetry):
    topics = odometry_and_joints(telemetry)
    topics["/joints"].append(joint_state(telemetry, 3, stamps()[-1]))
    found = inspect_log(write(topics))
    assert found.partial == {}
    screened = screen(found.log)
    assert +Counter(screened.rejected) == {"encoders": 1, "joint_rates": 1}
    np.testing.assert_array_equal(screened.log.encoders.value, telemetry.q)
    np.testing.assert_array_equal(screened.log.position.value, telemetry.p_WB)


def test_two_values_of_thrust_with_one_stamp_are_refused(write, telemetry):
    """One of them would hold until the next; the same value twice says nothing new."""

    def messages(*forces):
        wrench = [TYPES["Wrench"](vector([k, 0, 0]), vector([0, 0, 0])) for k in forces]
        return [TYPES["WrenchStamped"](header(stamps()[2]), each) for each in wrench] + [
            TYPES["WrenchStamped"](header(stamps()[9]), wrench[0])
        ]

    topics, chosen = odometry_and_joints(telemetry), {"thrust": "/thrusters"}
    bag = write(topics | {"/thrusters": messages(1, 1)})
    screened = screen(read_log(bag, topics=chosen))
    assert +Counter(screened.rejected) == {"thrust": 1}
    assert len(screened.log.thrust) == 2
    bag = write(topics | {"/thrusters": messages(1, 2)})
    with pytest.raises(InputError, match=r"'thrust' at 0.02 s comes after that at 0.02 s"):
        screen(read_log(bag, topics=chosen))


def test_one_of_several_topics_is_chosen_by_name(write, telemetry):
    topics = odometry_and_joints(telemetry)
    topics["/slam"] = [odometry(telemetry, 0, stamp) for stamp in stamps()]
    bag = write(topics)
    with pytest.raises(InputError, match=r"several .*: /odom, /slam; .*'odometry': '/odom'"):
        read_log(bag)
    assert_equal(read_log(bag, topics={"odometry": "/odom"}), telemetry)
    assert np.ptp(read_log(bag, topics={"odometry": "/slam"}).position.value) > 0
    assert np.ptp(read_log(bag, topics={"odometry": "/slam"}).position.value[:, 0]) == 0


def covariant(telemetry, k, stamp):
    posed = TYPES["PoseWithCovariance"](pose(telemetry, k), np.zeros(36))
    return TYPES["PoseWithCovarianceStamped"](header(stamp), posed)


def transform(telemetry, k, stamp, child="bus"):
    w, x, y, z = telemetry.quaternion_WB[k]
    moved = TYPES["Transform"](vector(telemetry.p_WB[k]), TYPES["Quaternion"](x, y, z, w))
    return TYPES["TransformStamped"](header(stamp), child, moved)


def transforms(telemetry, k, stamp):
    """As a tree of frames is published: the base is neither the first nor the last."""
    others = [transform(telemetry, 0, stamp, child) for child in ("dock", "arm")]
    parts = [others[0], transform(telemetry, k, stamp), others[1]]
    return STORE.types["tf2_msgs/msg/TFMessage"](parts)


POSES = ("attitude", "position", "encoders", "joint_rates")


@pytest.mark.parametrize("make", [stamped_pose, covariant, transform])
def test_every_type_of_pose_is_read(write, telemetry, make):
    topics = {"/mocap": series(make, telemetry), "/j": series(joint_state, telemetry)}
    assert_equal(read_log(write(topics)), telemetry, POSES)


def test_of_many_transforms_those_between_the_named_frames_are_read(write, telemetry):
    bag = write({"/tf": series(transforms, telemetry), "/j": series(joint_state, telemetry)})
    assert_equal(read_log(bag, topics={"pose": "/tf:world:bus"}), telemetry, POSES)
    for topics, words in [
        ({}, "no topic with the motion of the base.*--topic pose=/tf:WORLD:BASE"),
        ({"pose": "/tf"}, "several frames: world to arm; world to bus; .*pose=/tf:world:"),
        ({"pose": "/tf:bus:hand"}, "no transform from bus to hand, only world to arm; "),
    ]:
        with pytest.raises(InputError, match=words):
            read_log(bag, topics=topics)


def test_topics_that_are_not_used_are_listed(write, telemetry):
    topics = odometry_and_joints(telemetry)
    topics |= {"/mocap": series(transform, telemetry), "/tf": series(transforms, telemetry)}
    found = inspect_log(write(topics))
    assert_equal(found.log, telemetry)
    assert found.ignored == ("topic /mocap (TransformStamped)", "topic /tf (TFMessage)")


@pytest.mark.parametrize("topics", [("/j", "/j"), ("/arm", "/wheels")])
def test_joints_in_messages_of_their_own_are_merged_by_name(write, telemetry, topics):
    """Two drivers publish in turn: the second half of the joints, half a step later."""
    halves = np.split(np.arange(len(telemetry.joint_names)), 2)
    first, second = (
        [joint_state(telemetry, k, stamp + late, order=half) for k, stamp in enumerate(stamps())]
        for half, late in zip(halves, (0, 1000))
    )
    messages = {"/odom": series(odometry, telemetry)}
    if topics[0] == topics[1]:
        messages["/j"] = [each for pair in zip(first, second) for each in pair]
    else:
        messages |= dict(zip(topics, (first, second)))
    received = [START + k for k in range(2 * COUNT)]
    found = read_log(write(messages, received=received))
    assert found.joint_names == telemetry.joint_names
    assert "rows of their own" in found.notes["encoders"][0]
    # A microsecond of the motion between two samples.
    np.testing.assert_allclose(found.encoders.value, telemetry.q[1:], atol=2e-3)
    np.testing.assert_allclose(found.joint_rates.value, telemetry.qdot[1:], atol=2e-3)


def test_a_joint_of_two_topics_is_refused_until_one_is_named(write, telemetry):
    both = {"/a": series(joint_state, telemetry), "/b": series(joint_state, telemetry)}
    bag = write({"/odom": series(odometry, telemetry)} | both)
    with pytest.raises(InputError, match=r"/a and /b both have 'q:.*--topic joints=/b"):
        read_log(bag)
    assert_equal(read_log(bag, topics={"joints": "/b"}), telemetry)


def test_what_a_driver_does_not_fill_is_absent(write, telemetry):
    """NaN rates, as ros2_control has them, an empty first message, and a pose that was lost."""
    topics = {"/pose": series(stamped_pose, telemetry), "/joints": series(joint_state, telemetry)}
    for message in topics["/joints"]:
        message.velocity[:] = np.nan
    topics["/joints"][0] = TYPES["JointState"](
        header(stamps()[0], ""), [], np.empty(0), np.empty(0), np.empty(0)
    )
    topics["/pose"][5].pose.position.x = np.nan
    found = inspect_log(write(topics))
    assert not found.problems
    log = found.log
    assert not len(log.joint_rates)
    np.testing.assert_array_equal(log.encoders.value, telemetry.q[1:])
    np.testing.assert_array_equal(log.position.value, np.delete(telemetry.p_WB, 5, axis=0))
    assert len(log.attitude) == COUNT
    assert log.notes["encoders"] == ("1 empty messages left out",)
    assert log.notes["position"] == ("1 samples of x, y, z are NaN, left out",)
    assert log.notes["joint_rates"] == ("empty or NaN in all rows: not filled",)


def test_rates_of_some_joints_only_are_left_out_and_told(write, telemetry):
    topics = odometry_and_joints(telemetry)
    for message in topics["/joints"]:
        message.velocity[2] = np.nan
    found = read_log(write(topics))
    assert not len(found.joint_rates)
    [note] = found.notes["joint_rates"]
    assert telemetry.joint_names[2] in note
    assert telemetry.joint_names[1] not in note


def test_messages_that_contradict_each_other_are_refused(write, telemetry):
    def damaged(topic, k, message):
        topics = odometry_and_joints(telemetry)
        topics[topic][k] = message
        return write(topics)

    stamp = stamps()[9]
    short = joint_state(telemetry, 9, stamp)
    short.position = short.position[:-1]
    twice = joint_state(telemetry, 0, stamps()[0])
    twice.name[1] = twice.name[0]
    for bag, words in [
        (damaged("/joints", 9, short), "message 9 has 11 values for 12 joints"),
        (damaged("/joints", 0, twice), "must name every joint once"),
        (damaged("/odom", 9, odometry(telemetry, 9, stamp, child="debris")), "several frames"),
        (damaged("/odom", 9, odometry(telemetry, 9, 0)), "jump back by 1.76374e.09 s at message 9"),
    ]:
        with pytest.raises(InputError, match=words):
            read_log(bag)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_damaged_bags_raise_one_error_only(write, telemetry, storage):
    bag = write(odometry_and_joints(telemetry.select(slice(8))), storage)
    (file,) = [file for file in bag.iterdir() if file.suffix in (".db3", ".mcap")]
    whole, rng = file.read_bytes(), np.random.default_rng(5)
    truncated = [whole[: int(len(whole) * part)] for part in (0.0, 0.01, 0.3, 0.6, 0.95)]
    for content in truncated:
        file.write_bytes(content)
        with pytest.raises(InputError):
            read_log(bag)
    refused = 0
    for _ in range(30):
        content = np.frombuffer(whole, np.uint8).copy()
        where = rng.integers(content.size, size=30)
        content[where] = rng.integers(256, size=where.size)
        file.write_bytes(content.tobytes())
        try:
            read_log(bag)  # noise in the numbers alone cannot be seen
        except InputError:
            refused += 1
    assert refused > 10
    file.write_bytes(whole)
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 8", "message_count: 9"))
    with pytest.raises(InputError, match="/odom: only 8 of 9 messages are present"):
        read_log(bag)
    metadata.write_text("rosbag2_bagfile_information: [1, 2")
    with pytest.raises(InputError, match="not a ROS bag"):
        read_log(bag)


@pytest.mark.parametrize("definition", ["wstring name", "unknown_package/Name name", "float32 x"])
def test_the_definition_of_a_topic_that_is_not_used_does_no_harm(write, telemetry, definition):
    """A bag may hold types of its own, which nothing here can parse, or with another hash."""
    bag = write(odometry_and_joints(telemetry), own=(("/own", "own_msgs/msg/Own", definition),))
    found = inspect_log(bag)
    assert_equal(found.log, telemetry)
    assert found.ignored == ("topic /own (Own)",)


# -- ROS 1 ---------------------------------------------------------------------------------------


def write_ros1(path: Path, topics: dict[str, list], own=()) -> Path:
    """Write a bag of ROS 1, whose headers count messages, and which holds its definitions."""
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    text = "geometry_msgs/TransformStamped[] transforms"
    store.register(typesys.get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    make = store.types["std_msgs/msg/Header"]
    with rosbag1.Writer(path) as writer:
        for topic, kind, definition in own:
            writer.add_connection(topic, kind, msgdef=definition, md5sum=32 * "0")
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, message in enumerate(deepcopy(messages)):
                for part in getattr(message, "transforms", (message,)):
                    part.header = make(k, part.header.stamp, part.header.frame_id)
                when = START + 5_000_000 + k * STEP  # of recording
                writer.write(connection, when, store.serialize_ros1(message, kind))
    return path


def test_a_bag_of_ros_1_gives_back_the_motion(tmp_path, telemetry):
    topics = odometry_and_joints(telemetry) | {"/imu": series(imu, telemetry)}
    own = (("/own", "own_msgs/msg/Own", "int32[ name"),)
    found = inspect_log(write_ros1(tmp_path / "run.bag", topics, own))
    assert_equal(found.log, telemetry)
    assert found.problems == []
    assert found.ignored == ("topic /own (Own)",)


def test_the_topics_of_a_bag_of_ros_1_are_chosen_as_of_ros_2(write, tmp_path, telemetry):
    topics = {"/tf": series(transforms, telemetry), "/j": series(joint_state, telemetry)}
    topics["/j"][-1] = joint_state(telemetry, 3, stamps()[3])  # comes twice
    topics["/mocap"] = series(stamped_pose, telemetry)
    old, new = write_ros1(tmp_path / "run.bag", topics), write(topics)
    chosen = {"pose": "/tf:world:bus"}
    one, other = (inspect_log(bag, topics=chosen) for bag in (old, new))
    assert one.partial == other.partial
    assert one.ignored == other.ignored == ("topic /mocap (PoseStamped)",)
    for name in POSES:
        np.testing.assert_array_equal(one.log[name].time, other.log[name].time)
        np.testing.assert_array_equal(one.log[name].value, other.log[name].value)
    with pytest.raises(InputError, match="no transform from bus to hand, only world to arm; "):
        read_log(old, topics={"pose": "/tf:bus:hand"})


def test_a_damaged_bag_of_ros_1_is_refused(tmp_path, telemetry):
    bag = write_ros1(tmp_path / "run.bag", odometry_and_joints(telemetry))
    whole = bag.read_bytes()
    for part in (0.0, 0.01, 0.5, 0.95):
        bag.write_bytes(whole[: int(len(whole) * part)])
        with pytest.raises(InputError, match=r"run.bag: not a ROS bag, or a damaged one"):
            read_log(bag)
    with pytest.raises(InputError, match=r"of ROS 1, give the \.bag file"):
        read_log(tmp_path)
