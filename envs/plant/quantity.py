"""The old name of :mod:`kerfgym.envs.engine.quantity`, for laws of users that were written before it moved."""

import warnings

from ..engine.quantity import *  # noqa: F403

warnings.warn(
    "kerfgym.envs.plant.quantity has moved to kerfgym.envs.engine.quantity; the old name will go",
    DeprecationWarning,
    stacklevel=2,
)
