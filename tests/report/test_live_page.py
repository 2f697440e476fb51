"""The live page without a browser: what it sends, whom it serves, and what it does not keep."""

import http.client
import json
import re
import signal
import socket
import sys
from dataclasses import replace
from subprocess import TimeoutExpired

import flyer_cases
import numpy as np
import pytest
from processes import HUNG, start

from cpid_drake import InputError, LivePage, OnlineIdentifier, identify, make_simulation
from cpid_drake.identification.checks import Check
from cpid_drake.report import live_server
from cpid_drake.report.live_history import START, LiveHistory

of_linux = pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.2 is one of Linux")


class Browser:
    """Takes the events of a page, as its script does."""

    def __init__(self, page: LivePage, host: str = "") -> None:
        _, _, address = page.address.partition("//")
        given, _, port = address.partition(":")
        self._connection = http.client.HTTPConnection(host or given, int(port), timeout=60)
        self._connection.request("GET", "/events")
        self._stream = self._connection.getresponse()
        self.points, self.state = [], {}

    def take(self) -> bool:
        """Take one event; return whether there was one."""
        for line in self._stream:
            if line.startswith(b"data: "):
                news = json.loads(line[6:], parse_constant=pytest.fail)  # no NaN
                self.points[news["valid"] :] = news["points"]
                self.state = news["state"]
                return True
        return False

    def take_until(self, key: str, value: object) -> None:
        while self.state.get(key) != value:
            assert self.take(), f"the stream ended before {key} was {value}"

    def leave(self) -> None:
        self._connection.close()


@pytest.fixture
def page():
    with LivePage("a run") as made:
        yield made


@pytest.fixture(scope="module")
def nothing():
    """What is known before the first sample."""
    return OnlineIdentifier(flyer_cases.flyer(), flyer_cases.SENSORS_OF_SAMPLE).estimate()


@pytest.fixture(scope="module")
def found(servicer, zero_momentum_motion, skewed_target):
    return identify(servicer, zero_momentum_motion(skewed_target, 8, 3), rows="standard")


def test_a_browser_gets_the_estimate_with_its_interval(page, found, skewed_target):
    page.show(7.0, found)
    browser = Browser(page)
    browser.take_until("status", "7.0 s")
    [[time, values, low, high, residuals]] = browser.points
    assert time == 7.0
    np.testing.assert_allclose(values, skewed_target.to_vector(), rtol=1e-6)
    np.testing.assert_allclose([low, high], found.intervals.T, rtol=1e-6)
    assert residuals.keys() == found.residuals.keys()
    assert browser.state["title"] == "a run"
    assert re.fullmatch(r"60 ± 0\.0000\d+ kg", browser.state["numbers"][0])
    assert browser.state["passed"] is found.passed


def test_what_is_not_known_is_null_and_in_words(page, nothing):
    page.show(0.5, nothing)
    browser = Browser(page)
    browser.take_until("status", "0.5 s")
    assert browser.points[0][1] == [None] * 10
    assert browser.state["numbers"] == ["not identifiable"] * 10


def test_problems_are_shown_as_text(page, found):
    bad = replace(
        found,
        checks=(Check("log", "the gyro is in deg/s"),),
        rejected={"gyro": 7, "encoders": 0, "position": 2},
        warnings=("the noise is large",),
    )
    page.show(1.0, bad, status="0.4 s late", problems=["/imu: no message for 3.0 s"])
    browser = Browser(page)
    browser.take_until("status", "1.0 s; 0.4 s late")
    assert browser.state["problems"] == [
        "Failed check: the gyro is in deg/s",
        "/imu: no message for 3.0 s",
        "Rejected samples: 7 of gyro, 2 of position",
        "Warning: the noise is large",
    ]
    assert browser.state["verdict"] == "a check failed"
    assert browser.state["samples"].endswith("9 rejected")


def test_before_the_first_sample_there_are_problems_but_no_points(page, nothing):
    page.show(np.nan, nothing, problems=["/imu: no message yet"])
    browser = Browser(page)
    browser.take_until("problems", ["/imu: no message yet"])
    assert browser.points == []
    assert browser.state["status"] == "no samples yet"


def test_browsers_follow_a_run_from_wherever_they_come(page, found):
    """One from the start, one from the middle; a time that is set back begins anew."""
    early = Browser(page)
    for time in range(5):
        page.show(float(time), found)
    late = Browser(page)
    page.show(5.0, found)
    for browser in (early, late):
        browser.take_until("status", "5.0 s")
        assert [time for time, *_ in browser.points] == [0, 1, 2, 3, 4, 5]
    page.show(2.0, found)
    for browser in (early, late):
        browser.take_until("status", "2.0 s")
        assert [time for time, *_ in browser.points] == [2.0]


def test_a_browser_that_left_or_does_not_read_stops_nothing(found):
    with LivePage() as page:
        gone, silent = Browser(page), Browser(page)
        gone.leave()
        for time in range(1000):
            page.show(float(time), found)
        reader = Browser(page)
        reader.take_until("status", "999.0 s")
    del silent


def test_the_last_event_says_that_the_run_has_ended(found):
    with LivePage() as page:
        page.show(3.0, found)
        browser = Browser(page)
        page.close()
        page.close()  # a second time changes nothing
        browser.take_until("isClosed", True)
        assert "ended" in browser.state["end"]
        assert browser.state["status"] == "3.0 s"
        while browser.take():
            pass
    with pytest.raises(ConnectionRefusedError):
        Browser(page)


def test_an_error_in_the_run_ends_the_page(found):
    with pytest.raises(KeyboardInterrupt), LivePage() as page:
        raise KeyboardInterrupt
    with pytest.raises(ConnectionRefusedError):
        Browser(page)


def test_it_waits_for_enter_if_asked(monkeypatch, capsys):
    monkeypatch.setattr("builtins.input", lambda: "")
    page = LivePage()
    page.close(wait=True)
    out, error = capsys.readouterr()
    assert error == f"Open {page.address}\n"
    assert out == f"{page.address} is open until Enter or Ctrl-C"


@pytest.mark.parametrize("before", ["", "sys.stdin = None"])
def test_without_input_it_waits_for_an_interrupt(tmp_path, before):
    """As of a process in the background."""
    code = f"import sys, cpid_drake; {before}\ncpid_drake.LivePage().close(wait=True)"
    process = start("-c", code, cwd=tmp_path)
    process.stdin.close()
    text = "is open until Enter or Ctrl-C"
    printed = ""
    while text not in printed:
        printed += process.stdout.read(1)
    with pytest.raises(TimeoutExpired):
        process.wait(0.5)
    process.send_signal(signal.SIGINT)
    assert process.wait(HUNG) == 0
    assert process.stderr.read().count("\n") == 1  # its address


@of_linux
def test_it_is_served_on_this_computer_alone(page):
    """Another address of this computer, as one of a network, does not reach it."""
    assert page.address.startswith("http://127.0.0.1:")
    with pytest.raises(ConnectionRefusedError):
        Browser(page, "127.0.0.2")


@of_linux
def test_with_another_host_it_is_served_there():
    with LivePage(host="0.0.0.0") as page:
        assert Browser(page, "127.0.0.2").take()


def test_two_pages_have_two_ports(page):
    with LivePage() as other:
        assert other.address != page.address
        assert Browser(page).take()
        assert Browser(other).take()


@pytest.mark.parametrize("host", ["192.0.2.1", "1.2.3.4.5"])
def test_an_address_of_another_computer_is_refused(host):
    with pytest.raises(InputError, match=host):
        LivePage(host=host)


def test_without_a_free_port_there_is_one_line(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setattr(live_server, "PORTS", range(port, port + 1))
        with pytest.raises(InputError, match=rf"no port from {port} to {port} is free"):
            LivePage()


def test_the_page_loads_nothing_from_a_network(page):
    connection = http.client.HTTPConnection(*page.address.removeprefix("http://").split(":"))
    for path, kind in (("/", "text/html"), ("/plotly.min.js", "text/javascript")):
        connection.request("GET", path)
        answer = connection.getresponse()
        assert answer.headers["Content-Type"].startswith(kind)
        text = answer.read().decode()
        assert path != "/" or "https://" not in text
    connection.request("GET", "/../../etc/passwd")
    assert connection.getresponse().status == 404


def test_a_monitor_shows_the_identifier_of_a_diagram():
    simulation = make_simulation(flyer_cases.payload(2.0, 1e-6))
    with LivePage(truth=simulation.truth) as page:
        simulation.run(page.monitor(simulation.identifier, period=0.5))
        browser = Browser(page)
        assert browser.take()
        assert len(browser.points) in (4, 5)
        assert np.diff([time for time, *_ in browser.points]).min() > 0.5 - 1e-6
        np.testing.assert_allclose(browser.state["truth"], simulation.truth.to_vector())
        assert browser.points[-1][1][0] == pytest.approx(8.5, abs=0.01)
        assert 0 < browser.points[-1][4]["rows"] < 1e-3


def test_a_long_history_is_thinned_evenly():
    """However long it is: few points, the first and the newest among them, in even gaps."""
    history = LiveHistory(most=50)
    for k in range(1, 20_001):
        history.add(0.1 * k, f"{k}")
        _, valid, points = history.since(START)
        assert valid == 0
        assert len(points) <= 50
        assert points[-1] == f"{k}"
        assert points[0] == "1"
    gaps = np.diff([int(each) for each in points])
    assert len(points) > 20
    assert gaps[:-1].max() <= 2 * gaps[:-1].min()


def test_what_changed_since_a_place_gives_the_history():
    history, place, copy = LiveHistory(most=10), START, []
    times = [*range(40), 39, 39, *range(5), *range(100)]
    for k, time in enumerate(times):
        history.add(float(time), f"{time}")
        if k % 3 == 0:
            place, valid, new = history.since(place)
            copy[valid:] = new
            assert copy == list(history.since(START)[2])
            assert copy[-1] == f"{time}"
