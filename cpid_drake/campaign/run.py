"""The trials of a campaign on this machine's processors or on a cluster, by dask.distributed."""

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from uuid import uuid4

import dask
import pyarrow as pa
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from cpid_drake.campaign import store
from cpid_drake.campaign.campaign_schema import CampaignPlan, load_campaign
from cpid_drake.campaign.trial import failed_rows, run_chunk, schema_of
from cpid_drake.files.errors import InputError

CHUNK = 100
"""Number of trials of a task, which are propagated together: more tasks cost more time of Dask, and
one is lost whole with its worker, and needs memory for its trials."""

AHEAD = 3
"""Number of tasks of each worker that are submitted: enough to keep it busy, and few to hold."""


CONFIG = {
    "distributed.scheduler.allowed-failures": 1,  # the second death of a worker blames its tasks
    "distributed.deploy.lost-worker-timeout": "1h",  # a new process may take long to import
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 2**28,  # no memory back and forth
}
"""Settings of a cluster of processes on this machine."""

Chunk = tuple[int, int]
"""The first trial of a chunk, and the one after its last."""


@dataclass
class State:
    """The progress of a campaign.

    Attributes:
        total: number of all trials.
        done: number of trials in the folder.
        failed: number of trials of this run in which no estimator gave an estimate.
        dashboard: address of the page that shows what the workers do; empty if there is none.
        seconds: time since the start of this run [s].
        new: number of trials of this run.

    """

    total: int
    done: int
    failed: int = 0
    dashboard: str = ""
    seconds: float = 0.0
    new: int = 0


def run_campaign(
    campaign: str | Path | CampaignPlan,
    folder: str | Path,
    *,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    chunk: int = CHUNK,
    progress: Callable[[State], object] = lambda state: None,
) -> State:
    """Run the trials of a campaign that its folder does not have yet.

    A script that calls this needs `if __name__ == "__main__":`, because workers import it.

    Args:
        campaign: a YAML file, or what `load_campaign` returned.
        folder: where the trials are written; new, unless `resume` is true.
        resume: continue the campaign in the folder.
        workers: number of processes on this machine; default: one for each processor.
        scheduler: address of a running scheduler of dask.distributed, whose workers are used.
        chunk: number of trials of a task and of a file.
        progress: called at the start and after every chunk.

    Raises:
        InputError: the campaign is wrong; the folder has another one; no file can be written; the
            scheduler cannot be reached, or was lost.

    """
    plan = campaign if isinstance(campaign, CampaignPlan) else load_campaign(campaign)
    for name, value in (("chunk", chunk), ("workers", 1 if workers is None else workers)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    folder = Path(folder)
    store.open_folder(folder, plan, resume=resume)
    waiting = deque(store.missing(folder, plan, chunk))
    left = sum(last - first for first, last in waiting)
    state, start = State(plan.total, plan.total - left), monotonic()
    if not waiting:
        progress(state)
        return state
    # An OSError is the end of the scheduler: errors of files are InputErrors.
    with _client(workers, scheduler) as client, suppress(OSError):
        state.dashboard = client.dashboard_link or ""
        progress(state)
        for first, last, table in _tables(client, plan, waiting):
            store.write_chunk(folder, plan, first, table, last)
            state.done, state.new = state.done + last - first, state.new + last - first
            errors = zip(table["trial"].to_pylist(), table["error"].to_pylist())
            state.failed += last - first - len({trial for trial, error in errors if not error})
            state.seconds = monotonic() - start
            progress(state)
    if state.done < state.total:
        raise InputError(
            f"{folder}: the scheduler was lost, and {state.total - state.done} trials are missing: "
            "run the command again with --resume"
        )
    return state


@contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """Yield a client of the given scheduler, or of a new one with worker processes here."""
    for name in ("distributed", "distributed.client"):  # the folder shows what is lost
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = Client(scheduler, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"no scheduler at {scheduler}: {error}") from error
        with client:
            yield client
        return
    with (
        dask.config.set(CONFIG),
        LocalCluster(
            n_workers=workers,
            processes=True,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _tables(
    client: Client, plan: CampaignPlan, waiting: deque[Chunk]
) -> Iterator[tuple[int, int, pa.Table]]:
    """Yield the rows of chunks as they are finished; none of those that the scheduler loses.

    The death of a worker blames all its tasks. So a blamed chunk is done again alone, after all
    others; if it is blamed again, it is split, down to the trial that kills its worker.
    """
    running, chunks = as_completed(loop=client.loop, raise_errors=False), dict[str, Chunk]()
    blamed = deque[Chunk]()
    while True:
        room = AHEAD * max(len(client.nthreads()), 1) if client.status == "running" else 0
        is_alone = not (waiting or chunks) and bool(room and blamed)
        if is_alone:
            waiting.append(blamed.popleft())
        while waiting and len(chunks) < room:
            chunk = waiting.popleft()
            key = f"trials-{chunk[0]}-{chunk[1]}-{uuid4().hex}"
            chunks[key] = chunk
            running.add(client.submit(run_chunk, plan.text, *chunk, key=key, pure=False))
        if not chunks:
            return
        future = next(running)
        first, last = chunks.pop(future.key)
        if future.status in ("cancelled", "lost"):
            continue
        try:
            yield first, last, future.result()
        except KilledWorker:
            middle = (first + last) // 2
            if not is_alone:
                blamed.append((first, last))
            elif middle > first:
                blamed.extendleft([(middle, last), (first, middle)])
            else:
                rows = failed_rows(plan, first, "the process of its worker died")
                yield first, last, pa.Table.from_pylist(rows, schema_of(plan))
        except OSError:  # the end of the scheduler
            raise
        except Exception as error:  # not of a trial, but of a worker without the package
            raise InputError(f"trials {first} to {last - 1}: {error}") from error
        finally:
            future.release()
