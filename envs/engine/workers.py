"""Threads that help with a kernel: they sleep while they wait, and nobody waits for one that has not begun."""

import os
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

_GLANCE = 1.0  # s after which the caller looks for itself whether all have ended


class _Turn:
    """How a call that threads share has ended in those that have begun it."""

    def __init__(self) -> None:
        self.ended: list[BaseException | None] = []
        self.wake: SimpleQueue[None] = SimpleQueue()

    def wait(self, begun: int) -> None:
        """Until so many threads have ended their calls. An interrupt cannot cut this short: they write into memory
        that the caller may give away as soon as it goes on."""
        interrupt = None
        while len(self.ended) < begun:
            try:
                self.wake.get(timeout=_GLANCE)
            except Empty:
                pass
            except KeyboardInterrupt as raised:
                interrupt = raised
        if interrupt:
            raise interrupt


class Workers:
    """``count`` threads beside the caller's own."""

    def __init__(self, count: int) -> None:
        self._count, self._lock = count, threading.Lock()
        self._turns: SimpleQueue[tuple[Callable[[], None], _Turn]] = SimpleQueue()
        for _ in range(count):
            threading.Thread(target=self._work, name="kerfgym", daemon=True).start()

    def _work(self) -> None:
        while True:
            (call, turn), error = self._turns.get(), None
            try:
                call()
            except BaseException as raised:
                error = raised
            del call  # what it works on may be large
            turn.ended.append(error)
            turn.wake.put(None)
            del turn, error

    def share(self, call: Callable[[], None]) -> None:
        """Runs ``call`` here and in the other threads until the work that they share is done.

        On a busy machine a thread may not get its turn in time. Its call is then taken back: the work is done.
        """
        turn = _Turn()
        with self._lock:
            for _ in range(self._count):
                self._turns.put((call, turn))
            try:
                call()
            finally:  # the others must not go on with what the caller believes to be over
                turn.wait(self._count - self._take_back())
        for error in turn.ended:
            if error is not None:
                raise error

    def _take_back(self) -> int:
        """Withdraws the calls that no thread has begun; their number."""
        for taken in range(self._count):
            try:
                self._turns.get_nowait()
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
