"""``kerfgym tune``: searches any declared parameter of a controller in compiled roll-outs."""

from .controllers import Result, tune
from .goals import Limit, Limits
from .study import Task

__all__ = ["Limit", "Limits", "Result", "Task", "tune"]
