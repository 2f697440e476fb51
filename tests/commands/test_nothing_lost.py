"""A killed process and a full disk leave the old output or the new one, whole, and all inputs."""

import random
import resource
from functools import partial

import pytest
from killed_writers import WRITERS, Bench
from processes import finish, start

pytestmark = pytest.mark.slow
LIMIT = 500
"""Largest size of a file for a process without space [bytes]; every output is larger."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("killed"))


@pytest.mark.parametrize("name", WRITERS)
def test_a_killed_command_leaves_the_old_output_or_the_new_one(bench, name):
    """Soon after its first draft appears."""
    numbers = random.Random(name)
    for _ in range(2):
        assert set(bench.kill(name, numbers)) <= {"old", "new", "unfinished"}


@pytest.mark.parametrize("name", WRITERS)
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
