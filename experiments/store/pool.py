"""Pools: tasks spread over processes of this machine, or over the workers of a dask cluster.

What a task gives depends on nothing but the task, so every pool gives the same.
"""

import asyncio
import concurrent.futures
import contextlib
import importlib.util
import logging
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from ...envs.engine.quantity import InvalidInput, check_choice
from ...envs.safety import secrets

BACKENDS = ("loky", "dask")
"""Processes of this machine · a dask cluster, its own or one that is told by its scheduler's address."""

ANSWER = 2.0
"""Seconds until a scheduler must have answered."""

PATIENCE = 20
"""Seconds until it must have workers."""

_ADDRESS = re.compile(r"(?:\w+://)?(\[[^\]]+\]|[^\[\]:/@]+):(\d{1,5})/?")


def check(backend: str, workers: int, scheduler: str | None) -> None:
    """Makes sure that there is such a pool.

    Raises:
        InvalidInput: unknown backend, no worker, a scheduler for another backend than dask, or one that does not
            answer.
    """
    check_choice(backend, BACKENDS, "backend")
    for package in ("distributed", "cryptography") if backend == "dask" else ():
        if importlib.util.find_spec(package) is None:
            raise InvalidInput(f"--backend dask needs the package {package}: pip install 'kerfgym[dask]'")
    if workers < 1:
        raise InvalidInput(f"--jobs {workers} is out of range; at least 1")
    if scheduler is not None and backend != "dask":
        raise InvalidInput("--scheduler is the address of a dask scheduler; it needs --backend dask")
    if scheduler is not None:
        _answers(scheduler)


def _answers(scheduler: str) -> None:
    """Raises :class:`InvalidInput` unless a scheduler answers at the address. By itself dask would ask for half a
    minute, and wait for ever for somebody else's answer."""
    shown = secrets.masked_word(scheduler)
    found = _ADDRESS.fullmatch(scheduler)
    if not found or int(found[2]) > 65535:
        raise InvalidInput(f"--scheduler '{shown}' is not an address such as tls://10.0.0.1:8786")
    try:
        socket.create_connection((found[1].strip("[]"), int(found[2])), timeout=ANSWER).close()
        with concurrent.futures.ThreadPoolExecutor(1) as thread:  # whoever calls may have a loop of his own
            thread.submit(asyncio.run, _greeted(scheduler)).result()
    except Exception as error:  # a stranger's answer may be anything, also a length beyond all memory
        said = str(error) or "it does not greet as one does"
        raise InvalidInput(f"no dask scheduler at '{shown}': {secrets.without(said, scheduler)}") from None


async def _greeted(scheduler: str) -> None:
    """Says hello to a scheduler as its clients do."""
    from distributed import Security
    from distributed.comm import connect

    how = Security().get_connection_args("client")
    async with asyncio.timeout(ANSWER):
        (await connect(scheduler, timeout=ANSWER, **how)).abort()


def spread(
    function: Callable[[Any], Any],
    tasks: list[Any],
    workers: int,
    backend: str = "loky",
    scheduler: str | None = None,
    few: int = 2,
) -> Iterator[Any]:
    """``function`` of every task, in the order in which they are done.

    Args:
        function, tasks, workers, backend, scheduler: what is done, and by whom.
        few: so many tasks are done here: they are over before processes have begun.

    Raises:
        InvalidInput: the scheduler does not answer or has no workers; or what ``function`` raises.
    """
    from joblib import Parallel, delayed

    if backend == "dask" and tasks:
        with _cluster(workers, scheduler):
            yield from Parallel(n_jobs=-1, return_as="generator_unordered")(delayed(function)(task) for task in tasks)
    elif workers == 1 or len(tasks) <= few:
        for task in tasks:
            yield function(task)
    else:
        ending = {"initializer": _end_with, "initargs": (os.getpid(),)}
        pool = Parallel(n_jobs=workers, return_as="generator_unordered", inner_max_num_threads=1, **ending)
        yield from pool(delayed(function)(task) for task in tasks)


def _end_with(parent: int) -> None:
    """Ends this process when the one that started it is gone; loky's would wait for work for another five minutes."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _certificates() -> Any:
    """Of a cluster of this process alone, kept in memory."""
    from distributed import Security

    return Security.temporary()


@contextlib.contextmanager
def _cluster(workers: int, scheduler: str | None) -> Iterator[None]:
    """Makes joblib use a dask cluster: that of the scheduler, or one of its own with as many processes as asked for."""
    import dask.config
    from distributed import Client, LocalCluster
    from joblib import parallel_config

    with contextlib.ExitStack() as stack:
        cluster: Any = scheduler
        if scheduler is None:
            # Whoever can talk to a scheduler can have its workers run code. This one and its workers listen on this
            # machine only, and talk TLS with certificates that are made now and never written down.
            silent: dict[str, Any] = {f"distributed.{who}.http.routes": [] for who in ("scheduler", "worker")}
            stack.enter_context(dask.config.set(silent))
            shut = {"dashboard_address": None, "silence_logs": logging.ERROR, "security": _certificates()}
            local = {"threads_per_worker": 1, "host": "127.0.0.1", "protocol": "tls://"}
            cluster = stack.enter_context(LocalCluster(n_workers=workers, **local, **shut))
            cluster.scheduler.http_server.stop()  # it would serve nothing, but at port 8787
        elif not scheduler.startswith("tls://"):
            print(
                f"kerfgym: warning: '{secrets.masked(scheduler)}' does not ask who talks to it: everybody who reaches "
                "it can run code as the user of its workers. Use a tls:// address, or a network of your own",
                file=sys.stderr,
            )
        if scheduler is not None:
            _answers(scheduler)
        try:
            client = stack.enter_context(Client(cluster, timeout=PATIENCE))
            client.wait_for_workers(1, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            at = secrets.masked(str(scheduler))
            raise InvalidInput(f"no dask workers at '{at}': {secrets.without(str(error), str(scheduler))}") from None
        stack.enter_context(parallel_config(backend="dask", client=client))
        yield
