"""Workers: every block once, whatever the threads do; errors reach the caller; nobody spins, nobody waits for ever."""

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import weakref

import numpy as np
import pytest

from kerfgym.envs.engine import workers
from kerfgym.envs.engine.workers import Workers
from kerfgym.envs.plant import heads, idle
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet

IDLE = make_law(idle, "idle")
PATIENCE = 30.0
"""s after which a thread is taken to be deadlocked."""


def in_time(call):
    """Runs ``call`` in a thread that must end."""
    failed = []

    def run():
        try:
            call()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert not thread.is_alive(), "deadlock"
    for error in failed:
        raise error


class Blocks:
    """Work in blocks, of which each thread takes the next until none is left."""

    def __init__(self, count: int) -> None:
        self.done = [0] * count
        self.callers: list[threading.Thread] = []
        self._next = itertools.count()

    def work(self) -> None:
        self.callers.append(threading.current_thread())
        for block in self._next:
            if block >= len(self.done):
                return
            self.done[block] += 1


def helping() -> bool:
    return threading.current_thread().name == "kerfgym"


# -------------------------------------------------------------------------------------------------- every block once


@pytest.mark.parametrize("threads", [1, 2, 3, 4])
def test_each_block_is_done_once_and_when_share_returns_all_threads_have_ended_their_call(threads):
    helpers = Workers(threads - 1)
    for count in [0, 1, 2, 100] * 25:
        blocks, inside = Blocks(count), itertools.count()

        def call(blocks=blocks, inside=inside):
            next(inside)
            blocks.work()
            time.sleep(1e-4)
            blocks.callers.pop()

        in_time(lambda call=call: helpers.share(call))
        assert blocks.done == [1] * count
        assert blocks.callers == []
        assert 1 <= next(inside) <= threads


def test_all_threads_take_part_when_there_is_time():
    helpers, together = Workers(3), threading.Barrier(4, timeout=PATIENCE)
    in_time(lambda: helpers.share(together.wait))


@pytest.mark.parametrize("threads", [2, 3, 4])
def test_a_fleet_lives_the_same_life_on_any_number_of_threads(threads):
    fleets = []
    for count in (1, threads):
        fleet = Fleet(200, IDLE, heads.POOL, count)
        fleet.set("path.feed", np.arange(200), np.linspace(50.0, 300.0, 200))
        fleet.begin(np.arange(200), np.arange(200) + 7)
        for _ in range(60):
            fleet.advance()
        in_time(lambda fleet=fleet: fleet.advance(200))
        fleets.append(fleet)
    assert fleets[0].tick == fleets[1].tick
    assert fleets[0].column("signals.height").std() > 0.0
    for name in ("signals.height", "signals.raw_height", "motion.position", "supervisor.mode", "tally.lowest"):
        assert np.array_equal(fleets[0].column(name), fleets[1].column(name))


def test_helpers_for_a_number_of_threads_are_made_once_and_are_one_fewer():
    before = threading.active_count()
    helpers = workers.workers(7)
    assert threading.active_count() - before == 6
    assert workers.workers(7) is helpers
    assert threading.active_count() - before == 6


# -------------------------------------------------------------------------------------------------------------- errors


def test_an_error_in_a_helper_reaches_the_caller_and_the_helpers_go_on():
    helpers, begun = Workers(2), threading.Semaphore(0)

    def call():
        if helping():
            begun.release()
            raise KeyError("of a helper")
        for _ in range(2):
            assert begun.acquire(timeout=PATIENCE)

    for _ in range(3):
        with pytest.raises(KeyError, match="of a helper"):
            in_time(lambda: helpers.share(call))
    blocks = Blocks(50)
    in_time(lambda: helpers.share(blocks.work))
    assert blocks.done == [1] * 50


def test_after_an_error_of_the_caller_no_helper_is_still_at_work_and_the_next_call_is_as_any():
    helpers = Workers(2)

    def work(all_begun, ended, fails):
        if helping():
            all_begun.wait()
            time.sleep(0.05)
            ended.append(1)
            return
        all_begun.wait()
        if fails:
            raise KeyError("of the caller")

    def share(fails):
        all_begun, ended = threading.Barrier(3, timeout=PATIENCE), []
        try:
            in_time(lambda: helpers.share(lambda: work(all_begun, ended, fails)))
        finally:
            assert ended == [1, 1]

    for _ in range(3):
        with pytest.raises(KeyError, match="of the caller"):
            share(fails=True)
        share(fails=False)


def test_calls_that_no_helper_has_begun_are_withdrawn_when_the_caller_fails(monkeypatch):
    late = []
    monkeypatch.setattr(threading.Thread, "start", lambda thread: late.append(thread))
    helpers = Workers(2)
    monkeypatch.undo()
    calls = []

    def fail():
        calls.append(1)
        raise KeyError("of the caller")

    with pytest.raises(KeyError, match="of the caller"):
        in_time(lambda: helpers.share(fail))
    for thread in late:
        thread.start()
    in_time(lambda: helpers.share(threading.Barrier(3, timeout=PATIENCE).wait))
    assert calls == [1]


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to threads")
def test_an_interrupt_waits_for_the_helpers_because_they_write_into_the_caller_s_memory():
    assert threading.current_thread() is threading.main_thread(), "interrupts reach the main thread only"
    helpers, begun, ended = Workers(1), threading.Event(), []

    def call():
        if not helping():
            assert begun.wait(PATIENCE)
            raise KeyboardInterrupt
        begun.set()
        for _ in range(3):
            time.sleep(0.05)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.05)
        ended.append(1)

    with pytest.raises(KeyboardInterrupt):
        helpers.share(call)
    assert ended == [1]
    blocks = Blocks(50)
    helpers.share(blocks.work)
    assert blocks.done == [1] * 50


# --------------------------------------------------------------------------------------------------------------- times


def test_nobody_waits_for_helpers_that_have_not_begun_and_they_find_nothing_to_do_later(monkeypatch):
    late = []
    monkeypatch.setattr(threading.Thread, "start", lambda thread: late.append(thread))
    helpers = Workers(3)
    monkeypatch.undo()
    calls = [Blocks(20) for _ in range(5)]
    for blocks in calls:
        in_time(lambda blocks=blocks: helpers.share(blocks.work))
    for thread in late:
        thread.start()
    time.sleep(0.05)
    assert [blocks.done for blocks in calls] == [[1] * 20] * 5
    assert all(len(blocks.callers) == 1 for blocks in calls)
    together = threading.Barrier(4, timeout=PATIENCE)  # from now on they help
    in_time(lambda: helpers.share(together.wait))


@pytest.mark.parametrize("threads", [2, 4])
def test_thousands_of_calls_in_a_row_do_not_deadlock(threads):
    helpers, total = Workers(threads - 1), 0

    def many():
        nonlocal total
        for k in range(5000):
            blocks = Blocks(k % 5)
            helpers.share(blocks.work)
            total += sum(blocks.done)

    in_time(many)
    assert total == 10_000


def test_threads_of_the_user_may_share_the_same_helpers():
    helpers, failed = Workers(2), []

    def user():
        for _ in range(100):
            blocks = Blocks(7)

            def call(blocks=blocks):
                blocks.work()
                time.sleep(1e-4 * helping())
                blocks.callers.pop()

            helpers.share(call)
            if blocks.done != [1] * 7 or blocks.callers:
                failed.append(blocks)

    users = [threading.Thread(target=user, daemon=True) for _ in range(4)]
    for thread in users:
        thread.start()
    for thread in users:
        thread.join(PATIENCE)
        assert not thread.is_alive(), "deadlock"
    assert failed == []


def test_helpers_that_wait_take_no_processor_time():
    helpers = Workers(4)
    blocks = Blocks(1000)
    in_time(lambda: helpers.share(blocks.work))
    time.sleep(0.02)
    start = time.process_time()
    time.sleep(0.5)
    assert time.process_time() - start < 0.02


# ------------------------------------------------------------------------------------------------------------ lifetime


def test_helpers_keep_nothing_of_what_they_have_worked_on():
    helpers, together = Workers(2), threading.Barrier(3, timeout=PATIENCE)

    class Large:
        def work(self):
            together.wait()

    large = Large()
    gone = weakref.ref(large)
    helpers.share(large.work)
    del large
    assert gone() is None


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_has_helpers_of_its_own():
    program = (
        "import os, threading\n"
        "from kerfgym.envs.engine.workers import workers\n"
        "together = threading.Barrier(3, timeout=10)\n"
        "workers(3).share(together.wait)\n"
        "child = os.fork()\n"
        "if not child:\n"
        "    threading.Timer(20, os._exit, (1,)).start()\n"
        "    workers(3).share(threading.Barrier(3, timeout=10).wait)\n"
        "    os._exit(0)\n"
        "print(os.waitpid(child, 0)[1])\n"
    )
    out = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=PATIENCE, check=True
    )
    assert out.stdout.split() == ["0"]
