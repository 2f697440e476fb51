"""The ROS 2 node beside a robot in another process: late, deaf, killed, started again."""

import json
import os
import re
import signal
import threading
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from processes import HUNG, ROOT, start

from cpid_drake import OnlineIdentifier, load_scenario, models_directory, read_log, shipped_scenario

pytestmark = pytest.mark.slow

for package in (
    *("rclpy", "sensor_msgs.msg", "geometry_msgs.msg", "nav_msgs.msg"),
    *("std_msgs.msg", "diagnostic_msgs.msg"),
):
    pytest.importorskip(package, reason="needs ROS 2: pip install 'cpid-drake[ros2]'")

FOLDER = models_directory() / "telemetry"
LOG, SENSORS = FOLDER / "free_flyer.csv", FOLDER / "free_flyer_sensors.yaml"
ROBOT = Path(__file__).with_name("ros_robot.py")
NODE = (
    *("-m", "cpid_drake", "live", "ros2", "--spacecraft", "free_flyer_payload"),
    *("--sensors", SENSORS, "--topic", "imu=/imu/data", "--topic", "pose=/pose"),
)
PERIOD = ("--", "--ros-args", "-p", "period:=0.25")


@pytest.fixture(autouse=True)
def alone(monkeypatch):
    """A domain of its own on this machine."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))


class Node:
    """The node as a process, and what it says."""

    def __init__(self, cwd, *options):
        self.process = start(*NODE, *options, *PERIOD, cwd=cwd)
        self.said = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in self.process.stderr:
            self.said.append(line)

    def wait_for(self, text: str) -> None:
        end = time.monotonic() + HUNG
        while not any(text in line for line in self.said):
            assert self.process.poll() is None, "".join(self.said)
            assert time.monotonic() < end, "".join(self.said)
            time.sleep(0.05)

    def end(self) -> tuple[int, str]:
        """Interrupt the node; return its code, and what it printed."""
        self.process.send_signal(signal.SIGINT)
        out = self.process.stdout.read()
        return self.process.wait(timeout=HUNG), out


@pytest.fixture
def node(tmp_path):
    """Return a function that starts the node, which is killed at the end."""
    started = []

    def make(*options) -> Node:
        started.append(Node(tmp_path, *options))
        return started[-1]

    yield make
    for each in started:
        each.process.kill()
        each.process.wait()


def robot(tmp_path, *options, rate: float = 2.0):
    """Start the robot."""
    return start(ROBOT, LOG, rate, *options, cwd=tmp_path)


def heard(process) -> dict[str, list]:
    """Wait for the robot's end; return what it printed, by kind."""
    out, error = process.communicate(timeout=HUNG)
    assert process.returncode == 0, error
    found: dict[str, list] = {}
    for line in out.splitlines():
        message = json.loads(line)
        found.setdefault(next(iter(message)), []).append(message)
    return found


def wait_until_it_says(process, what: str) -> None:
    """Wait until the robot says something of a kind."""
    for line in process.stdout:
        if line.startswith(f'{{"{what}"'):
            return
    raise AssertionError(process.stderr.read())


def counts(message: dict) -> list[int]:
    """Return the numbers of messages that the node has received, of all topics."""
    rows = message["diagnostics"].values()
    return [int(values["messages"]) for _, _, values in rows if "messages" in values]


def direct(end: float = np.inf):
    """Return what the samples give without ROS."""
    craft = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()
    identifier = OnlineIdentifier(craft, SENSORS)
    for name, stamp, value in read_log(LOG).between(0.0, end).messages():
        identifier.add(name, stamp, value)
    return identifier


@pytest.mark.parametrize("reliability", ["RELIABLE", "BEST_EFFORT"])
def test_it_identifies_what_the_robot_sends(node, tmp_path, reliability):
    """No message is lost; the estimate is that of the samples until its stamp."""
    running = node()
    what = heard(robot(tmp_path, "--reliability", reliability))
    code, printed = running.end()
    assert code == 0
    assert re.search(r"Target, by recursive_fit, from 4004 samples", printed)
    assert counts(what["diagnostics"][-1]) == [1001, 1001, 1001]
    last, expected = what["target"][-1], direct().estimate()
    assert last["frame"] == "capture_point"
    assert 8.0 < last["until"] <= 10.0
    np.testing.assert_allclose(last["target"], expected.parameters, rtol=1e-6)
    assert what["sigma_m"][-1]["sigma_m"] == pytest.approx(expected.covariance[0, 0] ** 0.5)
    parameters, *covariance = what["estimate"][-1]["estimate"]
    np.testing.assert_allclose(parameters, expected.parameters, rtol=1e-6)
    np.testing.assert_allclose(covariance, expected.covariance, rtol=1e-3, atol=1e-12)
    rows = what["diagnostics"][-1]["diagnostics"]
    assert rows["cpid: estimate"][0] == 0
    assert rows["cpid: noise"][0] == 0
    assert "all errors together" in rows["cpid: error budget"][2]


def test_its_page_shows_the_target_and_what_is_lost(node, tmp_path):
    """With --wait it stays after the node, until another interrupt."""
    running = node("--wait")
    heard(robot(tmp_path))
    running.wait_for("no message for")
    [address] = re.findall(r"Open (http\S+)", "".join(running.said))

    def state() -> dict:
        with urllib.request.urlopen(f"{address}/events") as events:
            return json.loads(events.readline()[len("data: ") :])["state"]

    end = time.monotonic() + HUNG
    while not any("no message for" in text for text in state()["problems"]):
        assert time.monotonic() < end
        time.sleep(0.1)
    shown = state()
    assert shown["numbers"][0].startswith("8.4")
    assert shown["scene"] is not None
    running.process.send_signal(signal.SIGINT)
    text = f"{address} is open until Enter"
    printed = ""
    while not printed.endswith(text):
        printed += running.process.stdout.read(1)
    assert state()["samples"] == "4004 samples, 0 rejected"
    code, _ = running.end()
    assert code == 0


def test_a_stall_of_the_node_costs_no_sample(node, tmp_path):
    """It is stopped for longer than a sample may be late."""
    running = node()
    sender = robot(tmp_path, rate=1.0)
    wait_until_it_says(sender, "target")
    running.process.send_signal(signal.SIGSTOP)
    time.sleep(0.8)
    running.process.send_signal(signal.SIGCONT)
    heard(sender)
    code, printed = running.end()
    assert code == 0
    assert "from 4004 samples" in printed


def test_a_node_that_starts_late_takes_what_comes(node, tmp_path):
    """It starts after the first sample. The robot waits for it at 8 s, if need be."""
    sender = robot(tmp_path, "--alone", "8", rate=1.0)
    wait_until_it_says(sender, "first")
    running = node()
    what = heard(sender)
    code, _ = running.end()
    received = counts(what["diagnostics"][-1])
    assert all(0 < each < 1001 for each in received)
    assert code in (0, 3)
    assert what["target"]


def test_a_robot_that_is_killed_and_starts_again_goes_on_where_it_was(node, tmp_path):
    """The samples after a gap are added to what is known; nothing begins again.

    What the node lacks when the robot is killed is lost; no later sample is.
    """
    running = node()
    first = robot(tmp_path, "--end", "4", "--die")
    first.communicate(timeout=HUNG)
    assert first.returncode == -signal.SIGKILL
    running.wait_for("no message for")
    what = heard(robot(tmp_path, "--start", "5", "--shift", "20"))
    running.wait_for("messages arrive")
    _, printed = running.end()
    rows = what["diagnostics"][-1]["diagnostics"]
    assert rows["cpid: stream"][2]["restarts"] == "0"
    assert all(501 < each <= 401 + 501 for each in counts(what["diagnostics"][-1]))
    assert rows["cpid: estimate"][:1] == [0]
    [mass] = re.findall(r"^ +m +(\S+)", printed, re.M)
    assert float(mass) == pytest.approx(8.5, abs=0.05)


def test_the_example_of_the_docs_shows_the_target(node, tmp_path):
    """`diagrams/ros2_robot.py` beside the command of docs/how-to/live.md."""
    running = node()
    example = start(ROOT / "diagrams/ros2_robot.py", cwd=tmp_path)
    out, error = example.communicate(timeout=HUNG)
    assert example.returncode == 0, error
    code, _ = running.end()
    assert code == 0
    *_, mass = re.findall(r"m = (\S+) kg", out)
    assert float(mass) == pytest.approx(8.5, abs=0.05)
