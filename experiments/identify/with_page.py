"""What ``kerfgym identify`` does: the machine's file, and the page beside it."""

from pathlib import Path

from ...envs.control.stack import resolve
from ..store.runs import write_text
from . import check_log, identified_page, identifying
from .log import read


def command(files: tuple[str, ...], out: str, like: str, overwrite: bool, check: str | None, controller: str) -> None:
    """Machine and page; what is asked is checked before anything is computed.

    Raises:
        InvalidInput: a file is there already, or a log cannot be used.
    """
    target = Path(out).with_suffix(".html")
    resolve(controller)
    unseen = read(check) if check else None
    if unseen:
        check_log.fit_for(unseen)
    found, logs = identifying.command(files, out, like, overwrite)
    write_text(target, identified_page.page(found, logs, like, unseen, controller))
    print(target)
