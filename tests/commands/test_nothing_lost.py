"""A killed process and a full disk leave the old output or the new one, whole, and all inputs."""

import random
import resource
from functools import partial

import pytest
from killed_writers import WRITERS, Bench
from processes import finish, start

QUICK = ("json", "convert", "simulate", "template")
LIMIT = 500
"""Largest size of a file for a process without space [bytes]; every output is larger."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("killed"), QUICK)


@pytest.mark.parametrize("at_draft", [False, True])
@pytest.mark.parametrize("name", QUICK)
def test_a_killed_command_leaves_the_old_output_or_the_new_one(bench, name, at_draft):
    """Twelve instants here; `tests/benchmarks/kill_writers.py` tries all commands more often."""
    numbers = random.Random(f"{name} {at_draft}")
    for _ in range(2 if at_draft else 1):
        assert set(bench.kill(name, numbers, at_draft)) <= {"old", "new", "unfinished"}


@pytest.mark.parametrize("name", QUICK)
def test_without_space_a_command_says_so_and_keeps_the_old_output(bench, name):
    writer = WRITERS[name]
    bench.restore(writer)
    no_space = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (LIMIT, LIMIT))
    ended = finish(
        start("-B", "-m", "cpid_drake", *writer.new, cwd=bench.folder, preexec_fn=no_space)
    )
    errors = [line for line in ended.stderr.splitlines() if "error" in line]
    assert ended.returncode == 2
    assert len(errors) == 1
    assert "cannot write there: File too large" in errors[0]
    assert set(bench.states(writer)) == {"old"}
    assert not bench.drafts()


def test_the_bench_notices_a_mixture(bench):
    """The test of this test: a folder of two runs, and a file that was cut."""
    writer = WRITERS["simulate"]
    bench.restore(writer)
    path = bench.folder / "run/telemetry.csv"
    path.write_bytes(bench.new["simulate"]["run/telemetry.csv"])
    assert "a mixture" in bench.states(writer)[0]
    writer = WRITERS["convert"]
    (bench.folder / "c.npz").write_bytes(bench.new["convert"]["c.npz"][:-100])
    assert "a mixture" in bench.states(writer)[0]
    bench.restore(writer)
