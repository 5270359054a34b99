"""Numbers and tables as JSON holds them: short, and readable anywhere."""

import math
from typing import Any

import numpy as np
import pandas as pd

DIGITS = 6
"""Significant digits that are kept: more than any page shows, fewer than processors differ in."""


def plain(value: Any) -> Any:
    """As JSON takes it: numbers with :data:`DIGITS` digits, None for what is not a number, "inf" as a word."""
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, pd.Series | pd.DataFrame):
        return plain(value.to_dict() if isinstance(value, pd.Series) else value.to_dict("records"))
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(each) for each in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        number = float(value)
        if math.isnan(number):
            return None
        if math.isinf(number):
            return "inf" if number > 0 else "-inf"
        short = float(f"{number:.{DIGITS}g}")
        return int(short) if short.is_integer() and abs(short) < 1e15 else short
    return value if value is None else str(value)
