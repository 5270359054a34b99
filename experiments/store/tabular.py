"""Tables that were stored: numbers, names and pictures, and nothing else."""

from pathlib import Path

import pandas as pd

from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files

CELLS = 300_000_000
"""Numbers of a table; a compressed one may be small in its file and larger than memory."""

COLUMNS = 1000
"""Columns of a table; no run has a tenth of them."""

_TEXTS = (
    *("controller", "information", "scenario", "machine", "signal", "reason", "stage", "unit", "informed", "tied"),
    *("reasons", "note", "budget", "parameter", "scenarios", "warnings"),
)
"""Columns of words."""

_TEXTS_BESIDE = {"error": {"stage", "informed"}}
"""Columns of words in tables that have one of these columns, too: which error blame is about. In others, such as
traces, they are numbers."""

_PICTURES, _PNG = ("picture",), b"\x89PNG\r\n\x1a\n"
"""Columns of PNG files, and how each begins."""


def read_parquet(file: Path) -> pd.DataFrame:
    """A table of numbers and names from a Parquet file.

    Raises:
        InvalidInput: it cannot be read, is too large, or holds something else.
    """
    import pyarrow
    from pyarrow import parquet

    files.checked(file, files.NUMBERS)
    try:
        about = parquet.read_metadata(file)
        if about.num_rows * about.num_columns > CELLS:
            raise InvalidInput(f"'{file}' has {about.num_rows:,} rows; more than can be read")
        return _plain(pd.read_parquet(file), file)
    except InvalidInput:
        raise
    except (OSError, ValueError, TypeError, LookupError, NotImplementedError, pyarrow.ArrowException) as error:
        what = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise InvalidInput(f"'{file}' cannot be read ({what})") from None


def read_csv(file: Path) -> pd.DataFrame:
    """A table of numbers and names from a CSV file.

    Raises:
        InvalidInput: it cannot be read, or holds something else.
    """
    files.checked(file, files.NUMBERS)
    try:
        return _plain(pd.read_csv(file), file)
    except InvalidInput:
        raise
    except (OSError, ValueError) as error:
        raise InvalidInput(f"'{file}' cannot be read ({(str(error).splitlines() or [''])[0].rstrip('.')})") from None


def _plain(frame: pd.DataFrame, file: Path) -> pd.DataFrame:
    """The table, if what we count with is numbers, and names are text."""
    kinds, names = {"seed": "iu"}, set(frame.columns)
    if len(frame.columns) > COLUMNS:
        raise InvalidInput(f"'{file}' has {len(frame.columns):,} columns; more than can be read")
    for column in frame.columns:
        if not isinstance(column, str):
            raise InvalidInput(f"'{file}' has a column {column!r}; names are text")
        values = frame[column]
        if column in _TEXTS or column.startswith("iso_") or _TEXTS_BESIDE.get(column, set()) & names:
            if not values.map(lambda value: isinstance(value, str) or pd.isna(value)).all():
                raise InvalidInput(f"'{file}', column {column}: holds {values.dtype}, not text")
            if not values.map(lambda value: not isinstance(value, str) or files.is_text(value)).all():
                raise InvalidInput(f"'{file}', column {column}: holds control characters")
            continue
        if column in _PICTURES:
            if not values.map(lambda value: isinstance(value, bytes) and value.startswith(_PNG)).all():
                raise InvalidInput(f"'{file}', column {column}: holds what is no PNG")
            continue
        if values.dtype.kind not in kinds.get(column, "biufO" if values.isna().all() else "biuf"):
            wanted = "whole numbers" if column == "seed" else "numbers"
            raise InvalidInput(f"'{file}', column {column}: holds {values.dtype}, not {wanted}")
    for column in ("controller", "scenario", "information"):
        if column in frame and not frame[column].map(lambda value: isinstance(value, str)).all():
            raise InvalidInput(f"'{file}', column {column}: a name is missing or is no text")
    return frame
