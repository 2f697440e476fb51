"""Campaigns whose processes are killed at random instants: then `--resume` has every trial once."""

import json
import os
import random
import re
import signal
import sys
import time
from pathlib import Path

import pytest
from processes import HUNG, finish, start

pytest.importorskip("pyarrow")
cloudpickle = pytest.importorskip("cloudpickle")
dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")

from cpid_drake.campaign import store  # noqa: E402
from cpid_drake.campaign.campaign_schema import load_campaign  # noqa: E402
from cpid_drake.campaign.run import CONFIG, run_campaign  # noqa: E402
from cpid_drake.campaign.trial import run_chunk  # noqa: E402

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs /proc, to find processes"),
]

KILLS = int(os.environ.get("CPID_KILLS", "1"))
"""Number of instants at which a process is killed."""

CAMPAIGN = """
scenario: paper
trials: 120
repeated: 0.0
estimators: [standard]
fixed: {simulation.duration: 4.0, identification.period: 0.1, identification.offset: 0.1}
axes:
  target.mass: {uniform: [50, 150]}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    return tmp_path


def run(folder, *options):
    arguments = ("campaign", "run", "campaign.yaml", "--out", "out", "--chunk", "4", *options)
    return start("-m", "cpid_drake", *arguments, cwd=folder, start_new_session=True)


def wait_for_files(folder, more: float):
    """Wait until this many files, and a part of the time for one, have been added."""
    before, begin = len(list((folder / "out").glob("trials-*"))), time.monotonic()
    while len(list((folder / "out").glob("trials-*"))) < before + int(more):
        assert time.monotonic() < begin + HUNG
        time.sleep(0.02)
    time.sleep((more % 1) * 0.3)


def children(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found += [int(path.parent.name), *children(int(path.parent.name))]
    return found


def is_worker(pid: int) -> bool:
    """Return whether a process computes: the others watch resources."""
    try:
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def assert_every_trial_once(folder):
    plan = load_campaign(folder / "campaign.yaml")
    tables = list(store.read(folder / "out", plan))
    rows = [row for table in tables for row in table.to_pylist()]
    assert [row["trial"] for row in rows] == list(range(plan.total))
    assert all(row["error"] is None for row in rows)
    [expected] = run_chunk(plan.text, 57, 58).to_pylist()
    assert rows[57]["estimate"] == expected["estimate"]
    assert not list((folder / "out").glob(".*"))


def test_killed_workers(folder):
    """The campaign ends without `--resume`: others do their trials."""
    rng, process = random.Random(1), run(folder, "--workers", "2")
    for _ in range(KILLS):
        wait_for_files(folder, rng.uniform(0, 2))
        workers = [pid for pid in children(process.pid) if is_worker(pid)]
        if workers:
            os.kill(rng.choice(workers), signal.SIGKILL)
    ended = finish(process)
    assert ended.returncode == 0, ended.stderr
    assert_every_trial_once(folder)


def test_killed_clients(folder):
    rng = random.Random(2)
    for number in range(KILLS):
        process = run(folder, "--workers", "1", *(["--resume"] if number else []))
        while not (folder / "out/campaign.json").exists():
            assert process.poll() is None
            time.sleep(0.02)
        wait_for_files(folder, rng.uniform(0, 3))
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
    ended = finish(run(folder, "--workers", "1", "--resume"))
    assert ended.returncode == 0, ended.stderr
    assert_every_trial_once(folder)


def test_killed_schedulers(folder):
    rng = random.Random(3)
    for number in range(KILLS + 1):
        scheduler = start("-m", "distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file",
                          f"scheduler{number}.json", "--no-dashboard", cwd=folder)  # fmt: skip
        file = folder / f"scheduler{number}.json"
        while not file.exists() or not file.read_text().endswith("}"):
            assert scheduler.poll() is None
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        worker = start("-m", "distributed.cli.dask_worker", address, "--nthreads", "1",
                       "--no-dashboard", cwd=folder)  # fmt: skip
        process = run(folder, "--scheduler", address, *(["--resume"] if number else []))
        if number == KILLS:
            ended = finish(process)
            assert ended.returncode == 0, ended.stderr
        else:
            while not (folder / "out/campaign.json").exists():
                assert process.poll() is None
                time.sleep(0.02)
            wait_for_files(folder, rng.uniform(0, 3))
            os.kill(scheduler.pid, signal.SIGKILL)
            ended = finish(process)
            assert ended.returncode == 2
            said = ended.stderr.splitlines()[-1]  # it may be dead before it is asked for anything
            assert said.startswith("cpid: error: ")
            assert re.search("no scheduler at|the scheduler was lost.*--resume", said)
        for each in (worker, scheduler):
            each.kill()
            each.communicate()
    assert_every_trial_once(folder)


class Bomb(distributed.WorkerPlugin):
    """Of the trials, 5 kills its worker, and 9 raises."""

    def setup(self, worker):
        import os
        import signal

        from cpid_drake.campaign import trial

        own = trial._job

        def job(plan, number, values):
            if number == 5:
                os.kill(os.getpid(), signal.SIGKILL)
            if number == 9:
                raise ZeroDivisionError("by design")
            return own(plan, number, values)

        trial._job = job


def test_a_trial_that_kills_its_worker_and_one_that_raises_are_rows(folder):
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    campaign = folder / "campaign.yaml"
    campaign.write_text(CAMPAIGN.replace("trials: 120", "trials: 12"))
    plan = load_campaign(campaign)
    with (
        dask.config.set({**CONFIG, "distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.register_plugin(Bomb())
        run_campaign(plan, folder / "out", scheduler=cluster.scheduler_address, chunk=2)
    rows = [row for table in store.read(folder / "out", plan) for row in table.to_pylist()]
    assert [row["trial"] for row in rows] == list(range(12))
    errors = {row["trial"]: row["error"] for row in rows if row["error"]}
    assert errors == {5: "the process of its worker died", 9: "ZeroDivisionError: by design"}
