"""The old name of :mod:`kerfgym.envs.engine.lanes`, for laws of users that were written before it moved."""

import warnings

from ..engine.lanes import *  # noqa: F403

warnings.warn(
    "kerfgym.envs.plant.lanes has moved to kerfgym.envs.engine.lanes; the old name will go",
    DeprecationWarning,
    stacklevel=2,
)
