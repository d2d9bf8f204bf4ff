"""The workers of a campaign: processes on this machine, or whatever a running Dask scheduler has.

    with connect(scheduler=None, workers=2) as client:
        for result in run_tasks(client, tasks): ...     in the order in which they end
"""

import contextlib
import logging
import tempfile
import uuid

import campaign_shard
import cloudpickle
import dask
import distributed

TRIES = 4  # of a shard that broke
PATIENCE_S = 30


class ClusterError(Exception):
    """No workers, or not any more."""


class Sent:
    """A function of ours on its way to machines that do not have its module: pickled as it is, wherever
    the scheduler unpacks and packs it again."""

    def __init__(self, function):
        self.function = function
        self.__name__ = function.__name__

    def __call__(self, *arguments):
        return self.function(*arguments)

    def __reduce__(self):
        return cloudpickle.loads, (cloudpickle.dumps(self.function),)


def _quiet():
    """Workers that come and go are the scheduler's business; what matters is told by exceptions."""
    for name in ("distributed", "distributed.worker", "distributed.nanny", "distributed.scheduler",
                 "distributed.client", "distributed.core", "distributed.comm", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextlib.contextmanager
def _local(workers):
    with tempfile.TemporaryDirectory(prefix="berth-campaign-") as scratch:
        with distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1",
                dashboard_address=None, local_directory=scratch,
                silence_logs=logging.CRITICAL) as cluster, distributed.Client(cluster) as client:
            yield client


@contextlib.contextmanager
def _remote(address):
    try:
        client = distributed.Client(address, timeout=f"{PATIENCE_S} s", name="berth-campaign")
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(f"--scheduler: {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError as error:
            raise ClusterError(f"--scheduler: {address}: no worker within {PATIENCE_S} s") from error
        yield client


@contextlib.contextmanager
def connect(scheduler, workers):
    _quiet()
    cloudpickle.register_pickle_by_value(campaign_shard)
    settings = {"distributed.comm.timeouts.connect": f"{PATIENCE_S}s",
                "distributed.scheduler.allowed-failures": TRIES}
    with dask.config.set(settings):
        with _remote(scheduler) if scheduler else _local(workers) as client:
            yield client


def places(client):
    """Threads of all workers that there are now."""
    return sum(client.nthreads().values())


def run_tasks(client, tasks):
    """Yields the results of run_shard. A few more tasks than there are places are under way, so that
    the memory needed does not grow with the campaign. What a lost worker had is done by another."""
    left = iter(tasks)
    function = Sent(campaign_shard.run_shard)
    name = f"berth-{uuid.uuid4().hex[:8]}"
    running = distributed.as_completed()

    def start_some():
        while running.count() < max(4, 3 * places(client)):
            task = next(left, None)
            if task is None:
                return
            running.add(client.submit(function, task, key=f"{name}-{task['seed']}",
                                      retries=TRIES - 1, pure=False))

    start_some()
    while running.count() > 0:
        future = next(running)
        try:
            result = future.result()
        except distributed.scheduler.KilledWorker as error:
            raise ClusterError(f"a shard was lost with {TRIES} workers one after the other: {error}") from error
        except RuntimeError as error:
            raise ClusterError(f"a shard was tried {TRIES} times: {error}") from error
        except (distributed.client.FuturesCancelledError, distributed.CancelledError,
                distributed.comm.core.CommClosedError, OSError) as error:
            raise ClusterError(f"the scheduler is lost: {error}") from error
        future.release()
        yield result
        start_some()
