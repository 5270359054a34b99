"""Threads that help with a kernel: they sleep while they wait, and nobody waits for one that has not begun."""

import os
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue


class Workers:
    """``count`` threads beside the caller's own."""

    def __init__(self, count: int) -> None:
        self._count, self._lock = count, threading.Lock()
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._done: SimpleQueue[BaseException | None] = SimpleQueue()
        for _ in range(count):
            threading.Thread(target=self._work, name="kerfgym", daemon=True).start()

    def _work(self) -> None:
        while True:
            call, error = self._calls.get(), None
            try:
                call()
            except BaseException as raised:
                error = raised
            del call  # what it works on may be large
            self._done.put(error)

    def share(self, call: Callable[[], None]) -> None:
        """Runs ``call`` here and in the other threads until the work that they share is done.

        On a busy machine a thread may not get its turn in time. Its call is then taken back: the work is done.
        """
        with self._lock:
            for _ in range(self._count):
                self._calls.put(call)
            try:
                call()
            finally:  # the others must not go on with what the caller believes to be over
                begun = self._count - self._take_back()
                errors = [self._done.get() for _ in range(begun)]
        for error in errors:
            if error is not None:
                raise error

    def _take_back(self) -> int:
        """Withdraws the calls that no thread has begun; their number."""
        for taken in range(self._count):
            try:
                self._calls.get_nowait()
            except Empty:
                return taken
        return self._count


_workers: dict[int, Workers] = {}
os.register_at_fork(after_in_child=_workers.clear)  # threads do not outlive a fork


def workers(threads: int) -> Workers:
    """Helpers for ``threads`` threads in all, made when they are first needed."""
    if threads not in _workers:
        _workers[threads] = Workers(threads - 1)
    return _workers[threads]
