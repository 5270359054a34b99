"""``kerfgym tune``: searches any declared parameter of a controller in compiled roll-outs."""

from .goals import Limit, Limits
from .run import Result, tune
from .study import Task

__all__ = ["Limit", "Limits", "Result", "Task", "tune"]
