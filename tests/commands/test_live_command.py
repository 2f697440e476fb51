"""`cpid live replay`: a log in real time, with the end of `cpid identify`."""

import csv
import re
import signal
import time

import pytest
from flyer_cases import FREE_FLYER, SAMPLE, SENSORS_OF_SAMPLE
from processes import HUNG, start

SENSORS = ("--sensors", SENSORS_OF_SAMPLE)
CRAFT = ("--spacecraft", "free_flyer_payload")


def test_it_ends_with_the_target_of_the_log(cpid):
    """Of 8.5 kg, printed as `cpid identify` prints it."""
    code, live, said = cpid("live", "replay", SAMPLE, *CRAFT, *SENSORS, "--rate", 1000, "--no-show")
    assert code == 0
    [row] = re.findall(r"^ +m +(\S+) +\[(\S+), (\S+)\] +kg", live, re.M)
    estimate, low, high = map(float, row)
    assert low < 8.5 < high < 1.02 * estimate
    assert "4004 samples, 0 rejected" in said
    assert re.search(r" s late\n", said)  # what follows begins a line
    assert "recursive_fit" in live


def test_it_keeps_the_time_of_the_log(cpid):
    begin = time.monotonic()
    code, *_ = cpid("live", "replay", SAMPLE, *CRAFT, *SENSORS, "--rate", 5, "--quiet", "--no-show")
    assert code == 0
    assert time.monotonic() - begin > 10.0 / 5


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (FREE_FLYER, "give --sensors"),
        ((*CRAFT, *SENSORS, "--estimator", "trajectory_fit"), "--estimator"),
        ((*CRAFT, *SENSORS, "--from", "100"), "free_flyer.csv"),
        ((*CRAFT, *SENSORS, "--host", "192.0.2.1"), "no page can be served on 192.0.2.1"),
    ],
)
def test_what_cannot_be_replayed_is_refused(refusal, given, says):
    assert says in refusal("live", "replay", SAMPLE, *given)


def test_an_interrupted_replay_ends_with_its_page(tmp_path):
    options = (SAMPLE, *CRAFT, *SENSORS, "--rate", 0.1)
    process = start("-m", "cpid_drake", "live", "replay", *options, cwd=tmp_path)
    assert re.match(r"Open http://127\.0\.0\.1:\d+\n", process.stderr.readline())
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=HUNG)
    assert process.returncode == 130
    assert said.endswith("cpid: interrupted\n")
    assert "Traceback" not in said


@pytest.mark.slow
def test_logged_thrust_is_replayed_too(cpid, tmp_path):
    """Without it the burn would be a change of the momentum that nothing explains."""
    out = tmp_path / "run"
    assert cpid("simulate", "logged_burn", "--out", out)[0] == 0
    code, shown, _ = cpid(
        *("live", "replay", out / "telemetry.csv", "--spacecraft", out / "scenario.yaml"),
        *("--sensors", "flight", "--rate", 1000, "--no-show"),
    )
    assert code == 0, shown
    assert "change" not in shown


def split(folder, late):
    """Write the sample's attitude and position, later by a clock of their own, and the rest."""
    lines = [line for line in SAMPLE.read_text().splitlines() if not line.startswith("#")]
    rows = [*csv.DictReader(lines)]
    pose = ("qw", "qx", "qy", "qz", "x", "y", "z")
    rest = [name for name in rows[0] if name not in (*pose, "time")]
    files = []
    for file, names, delay in (("mocap.csv", pose, late), ("joints.csv", rest, 0.0)):
        with (folder / file).open("w") as out:
            writer = csv.writer(out)
            writer.writerow(["time", *names])
            for row in rows:
                if any(row[name] for name in names):
                    writer.writerow([float(row["time"]) + delay, *(row[name] for name in names)])
        files.append(str(folder / file))
    return "+".join(files)


def test_files_with_clocks_of_their_own_are_replayed_in_one(cpid, tmp_path):
    given = (*CRAFT, *SENSORS, "--rate", 1000, "--no-show")
    code, live, said = cpid("live", "replay", split(tmp_path, 0.7), *given)
    assert code == 0
    [behind] = re.findall(r"the clock of mocap\.csv is (\S+) s ahead", said)
    assert abs(float(behind) - 0.7) < 0.005
    [row] = re.findall(r"^ +m +(\S+) +\[(\S+), (\S+)\] +kg", live, re.M)
    _, low, high = map(float, row)
    assert low < 8.5 < high
