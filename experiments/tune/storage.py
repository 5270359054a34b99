"""Where a study is kept: a journal file in the run folder, or any database by its URL.

Many processes and machines may share a study. A journal whose last line was cut off by a kill or a full disk is
repaired before it is read on; a database is set up by one process while the others wait.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import re
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import optuna
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend
from optuna.storages.journal._file import BaseJournalFileLock
from optuna.storages.journal._storage import JournalOperation

from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files, secrets
from . import soundness

JOURNAL = "study.journal"
SPACE = "space"
"""Attribute of a study: what it searches, in words; another search cannot go on with it."""

FIXED = "fixed "
"""Begins the word for all that a study depends on and does not search."""

_LOCK = 0x6B657266
"""Key of PostgreSQL's advisory lock while a study is set up."""

TRIES = 8

CONNECT = 4
"""Seconds until a server must have taken the connection."""


class _Lock(BaseJournalFileLock):
    """A lock that the system takes away when its holder dies."""

    def __init__(self, file: Path) -> None:
        self._file, self._handle = file, -1

    def acquire(self) -> bool:
        self._handle = os.open(self._file, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(self._handle, fcntl.LOCK_EX)
        return True

    def release(self) -> None:
        os.close(self._handle)  # which unlocks it


def url_of(storage: str | None, folder: Path) -> str:
    """The storage's URL; the folder's journal unless told otherwise."""
    return storage or str(folder / JOURNAL)


def is_file(url: str) -> bool:
    """Whether the storage is a journal file."""
    return "://" not in url


def opened(url: str) -> BaseStorage:
    """The storage behind a URL, or a journal file.

    Raises:
        InvalidInput: unreachable, damaged, or a driver is missing.
    """
    if is_file(url):
        if "@" in url:
            raise InvalidInput("the storage has an @ but no ://; a URL is such as postgresql://user@host/database")
        try:
            return _replayed(_journal(Path(url)), Path(url))
        except OSError as error:
            raise InvalidInput(f"the journal '{url}' cannot be used: {error.strerror or error}") from None
    with reachable(url):
        # SQLAlchemy takes psycopg2 unless told otherwise; what is installed here is psycopg.
        return _connected(re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", url))


def _connected(url: str) -> BaseStorage:
    """The database behind a URL."""
    import sqlalchemy.exc

    try:
        if url.startswith("redis"):
            from optuna.storages.journal import JournalRedisBackend

            return JournalStorage(_WithoutSnapshots(JournalRedisBackend(url)))
        if url.startswith("postgresql"):
            return _postgresql(url)
        engine = sqlalchemy.create_engine(url)
        with engine.connect():  # what is not there is not tried again and again
            pass
        engine.dispose()
        return _again(lambda: RDBStorage(url))
    except ValueError:  # a port that is no number, say; what it says may hold the password
        raise sqlalchemy.exc.ArgumentError from None


def hidden(url: str) -> str:
    """The URL without its passwords."""
    return secrets.masked_word(url)


@contextlib.contextmanager
def reachable(url: str) -> Iterator[None]:
    """Turns what a storage throws into words.

    Raises:
        InvalidInput: the storage cannot be reached, or refuses.
    """
    import sqlalchemy.exc

    def said(error: Any) -> str:
        return secrets.without(str(error), url)

    try:
        yield
    except (ModuleNotFoundError, ImportError) as error:
        raise InvalidInput(f"storage '{hidden(url)}': a driver is missing: {said(error)}") from None
    except sqlalchemy.exc.ArgumentError:
        raise InvalidInput(
            f"storage '{hidden(url)}' is not a URL such as postgresql://user@host/database or sqlite:///file"
        ) from None
    except (sqlalchemy.exc.SQLAlchemyError, optuna.exceptions.StorageInternalError) as error:
        cause = error.__cause__ or error.__context__ or error
        line = str(getattr(cause, "orig", cause)).strip().splitlines()
        raise InvalidInput(
            f"storage '{hidden(url)}' cannot be used: {said(line[0]) if line else type(cause).__name__}; "
            "trials that it took are kept"
        ) from None
    except (ConnectionError, TimeoutError) as error:
        raise InvalidInput(f"storage '{hidden(url)}' cannot be reached: {said(error)}") from None
    except OSError as error:
        raise InvalidInput(
            f"cannot write '{error.filename or hidden(url)}': {error.strerror or error}; what is there is kept, "
            "and the same command goes on"
        ) from None


class _WithoutSnapshots(BaseJournalBackend):
    """A journal whose entries alone are read. Its snapshots are pickles, and whoever can write into the database could
    have them run code."""

    def __init__(self, backend: Any) -> None:
        self._backend = backend

    def read_logs(self, log_number_from: int) -> Any:
        return self._backend.read_logs(log_number_from)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        self._backend.append_logs(logs)


def _replayed(journal: JournalFileBackend, file: Path) -> JournalStorage:
    """A study as its journal tells it.

    Raises:
        InvalidInput: its entries do not fit each other; they were changed, or lost.
    """
    try:
        return JournalStorage(journal)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, AssertionError, OverflowError) as error:
        what = f"{type(error).__name__}: {error}".rstrip(": ").split("\n")[0][:200]
    except (optuna.exceptions.OptunaError, RuntimeError) as error:
        what = str(error).split("\n")[0][:200]
    raise InvalidInput(
        f"'{file}' cannot be read on: its entries do not fit each other ({what}); was it edited? Use another --name, "
        "or --overwrite to begin anew"
    )


def _journal(file: Path) -> JournalFileBackend:
    file.parent.mkdir(parents=True, exist_ok=True)
    lock = _Lock(file.with_name(f".{file.name}.lock"))
    lock.acquire()
    try:
        repair(file)
    finally:
        lock.release()
    return JournalFileBackend(str(file), lock_obj=lock)


def repair(file: Path) -> None:
    """Cuts off a last line that was not written to its end.

    Raises:
        InvalidInput: the file is damaged elsewhere too, or is no journal.
    """
    if not file.exists():
        return
    whole = files.data(file, files.NUMBERS)
    kept = whole[: whole.rfind(b"\n") + 1]
    made = {"study_id": 0, "trial_id": 0}
    for number, line in enumerate(kept.splitlines(), 1):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            entry = None
        if not isinstance(entry, dict) or "op_code" not in entry:
            raise InvalidInput(
                f"'{file}', line {number}: not a journal of a study; move it away, or use another --name"
            )
        # The library passes over what it does not know, and a study would go on without it.
        for key, many in made.items():
            if key in entry and not (type(entry[key]) is int and 0 <= entry[key] < many):
                raise InvalidInput(f"'{file}', line {number}: there is no {key} {entry[key]!r}; was it edited?")
        if not isinstance(entry.get("study_name", ""), str):
            raise InvalidInput(f"'{file}', line {number}: study_name = {entry['study_name']!r} is no text")
        made["study_id"] += entry["op_code"] == JournalOperation.CREATE_STUDY
        made["trial_id"] += entry["op_code"] == JournalOperation.CREATE_TRIAL
    if len(kept) < len(whole):
        with file.open("r+b") as handle:
            handle.truncate(len(kept))


def _postgresql(url: str) -> RDBStorage:
    """One process at a time makes the tables."""
    import sqlalchemy

    engine = sqlalchemy.create_engine(url, connect_args={"connect_timeout": CONNECT})
    with engine.connect() as connection:
        connection.execute(sqlalchemy.text(f"SELECT pg_advisory_lock({_LOCK})"))
        storage = RDBStorage(url, engine_kwargs={"pool_pre_ping": True})
    engine.dispose()
    return storage


def _again(make: Callable[[], Any]) -> Any:
    """What several processes may start at once on a fresh database: some lose a race, and find it done."""
    import sqlalchemy.exc

    for attempt in range(TRIES):
        try:
            return make()
        except (
            sqlalchemy.exc.IntegrityError,
            sqlalchemy.exc.ProgrammingError,
            sqlalchemy.exc.OperationalError,
            optuna.exceptions.StorageInternalError,
        ):
            if attempt == TRIES - 1:
                raise
            time.sleep(0.05 * 2**attempt)
    raise AssertionError


def study_of(url: str, name: str, directions: list[str], words: list[str], attributes: dict[str, Any]) -> Any:
    """The study of this name, made if there is none.

    Args:
        url: of the storage.
        name: of the study.
        directions: ``minimize`` or ``maximize``, one for each metric.
        words: what it searches, and how.
        attributes: of a study that is made now.

    Raises:
        InvalidInput: the storage cannot be used, or its study of this name searches something else.
    """
    storage = opened(url)
    optuna.logging.set_verbosity(optuna.logging.ERROR)

    def make() -> Any:
        try:
            study = optuna.create_study(storage=storage, study_name=name, directions=cast(Any, directions))
        except optuna.exceptions.DuplicatedStudyError:
            return optuna.load_study(study_name=name, storage=storage)
        for key, value in attributes.items():
            study.set_user_attr(key, value)
        study.set_user_attr(SPACE, words)  # last: with it the study is complete
        return study

    with reachable(url), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        study = _again(make)
        for _ in range(40):  # another process may be making it at this moment
            there = study.user_attrs.get(SPACE)
            if there is not None:
                break
            time.sleep(0.1)
        else:  # its maker died
            for key, value in {**attributes, SPACE: words}.items():
                study.set_user_attr(key, value)
            there = words
    if there != words:
        raise InvalidInput(
            f"the study '{name}' in '{hidden(url)}' is another one ({_difference(there, words)}); use another --name"
        )
    soundness.check(study, hidden(url))
    return study


def _difference(there: Any, words: list[str]) -> str:
    """How two studies differ; that of what is not searched is named where it is the only one."""
    if not isinstance(there, list) or not all(isinstance(word, str) for word in there):
        return f"{SPACE} is {str(there)[:80]!r}, no list of words"
    sides = [[w for w in mine if w not in other] for mine, other in ((there, words), (words, there))]
    plain = [[w for w in side if not w.startswith(FIXED)] for side in sides]
    if not any(plain):
        return "what is not searched has changed: the controller's law, the preset or another parameter"
    return "; ".join(
        f"{whose}: {', '.join(side)}" for whose, side in zip(("it has", "asked for"), plain, strict=False) if side
    )


def digest(words: list[str]) -> str:
    """A study's hash: of all that its trials depend on."""
    return hashlib.sha256(json.dumps(words, ensure_ascii=False).encode()).hexdigest()[:16]
