"""Checkpoints of a training: networks, optimisers, counters and replay buffer in one file, written atomically.

The file is torch's, loaded with ``weights_only=True``: tensors and plain values, nothing that could run code. Random
states are not in it: every checkpoint begins episodes and random sequences afresh from the seed and the steps done
(:func:`restart`), in a training that goes on as in one that is resumed. Both therefore end with the same bits, on the
same machine with the same number of threads.
"""

import errno
import os
import tempfile
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..envs.engine.lanes import mix
from ..envs.engine.quantity import InvalidInput
from ..envs.safety import files

FORMAT = "kerfgym training 1"
COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
LITTLE = 65536
"""Bytes; a disk with fewer free ones is full."""

MEMORY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer."""


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A file beside ``path`` that takes its place, flushed to the disk, when the block ends well.

    Raises:
        InvalidInput: the disk does not take it; ``path`` is as it was.
    """
    part = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        part = Path(name)
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)  # temporary files are private, checkpoints are not
        part.replace(path)
    except (OSError, RuntimeError) as error:  # the second is torch's word for a full disk
        reason = getattr(error, "strerror", None) or (os.strerror(errno.ENOSPC) if _full(path.parent) else error)
        raise InvalidInput(f"cannot write '{path}': {reason}; nothing written before is lost") from None
    finally:
        if part:
            part.unlink(missing_ok=True)


def _full(folder: Path) -> bool:
    """Whether the disk takes next to nothing any more."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize < LITTLE


def state_of(model: Any) -> dict[str, Any]:
    """Everything a model of stable-baselines3 needs to go on, as tensors and plain values."""
    import torch

    _, names = model._get_torch_save_params()
    state: dict[str, Any] = {
        "parameters": model.get_parameters(),
        "variables": {name: getattr(model, name).detach().clone() for name in names},
        "counters": {name: int(getattr(model, name)) for name in COUNTERS if hasattr(model, name)},
        "episodes": [{key: float(value) for key, value in info.items()} for info in model.ep_info_buffer or ()],
    }
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        rows = buffer.buffer_size if buffer.full else buffer.pos
        state["memory"] = {name: torch.from_numpy(getattr(buffer, name)[:rows]) for name in MEMORY}
        state["place"], state["full"] = int(buffer.pos), bool(buffer.full)
    return state


def put_state(model: Any, state: dict[str, Any]) -> None:
    """Makes ``model`` what it was when :func:`state_of` looked at it."""
    import torch

    model.set_parameters(state["parameters"], exact_match=True, device=model.device)
    with torch.no_grad():
        for name, value in state["variables"].items():
            getattr(model, name).copy_(value)
    for name, value in state["counters"].items():
        setattr(model, name, value)
    model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    if "memory" in state:
        for name, values in state["memory"].items():
            getattr(model.replay_buffer, name)[: len(values)] = values.numpy()
        model.replay_buffer.pos, model.replay_buffer.full = state["place"], state["full"]


def write(path: Path, content: dict[str, Any]) -> None:
    """Writes a checkpoint.

    Raises:
        InvalidInput: the disk does not take it; the last one is still there.
    """
    import torch

    with replaced(path) as part:
        torch.save({"format": FORMAT, **content}, part)


def read(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Reads a checkpoint.

    Raises:
        InvalidInput: not a checkpoint, or damaged.
    """
    files.checked(path, files.NUMBERS)
    import torch

    try:
        content = torch.load(path, map_location=device, weights_only=True)
    except Exception as error:  # zip, pickle and torch each have their own
        raise InvalidInput(f"'{path}' is not a checkpoint of kerfgym, or is damaged: {_first(error)}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InvalidInput(f"'{path}' is not a checkpoint of this version of kerfgym")
    return content


def _first(error: Exception) -> str:
    return (str(error).split("\n")[0] or type(error).__name__)[:160]


def restart(model: Any, seed: int) -> None:
    """Begins new episodes and new random sequences, which follow from the seed and the steps done so far."""
    import torch
    from stable_baselines3.common.utils import set_random_seed

    key = int(mix(np.uint64(seed), np.uint64(model.num_timesteps)) % np.uint64(2**31))
    set_random_seed(key, using_cuda=model.device.type == "cuda")
    model.action_space.seed(key)
    model.env.seed(key)
    model._last_obs = model.env.reset()
    model._last_episode_starts = np.ones(model.env.num_envs, bool)
    if getattr(model, "_last_lstm_states", None) is not None:
        states = model._last_lstm_states
        model._last_lstm_states = type(states)(*(tuple(torch.zeros_like(x) for x in pair) for pair in states))
