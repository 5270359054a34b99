"""``python -m kerfgym.experiments.studies.faults``; see the package's text."""

from typing import Annotated

import tyro

from ....envs.engine.quantity import InvalidInput
from ...measure import grids
from ...store import runs, script
from .found import PAGE, made
from .losses import MODULE
from .story import story

QUICK = (("xi2023-tuned", "lqg", "self-tuning"), 240)
"""Controllers and faults of ``--quick``."""


def main(
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (),
    faults: int = 12000,
    seed: int = 0,
    quick: bool = False,
    case: Annotated[str | None, tyro.conf.arg(metavar="CONTROLLER/SCENARIO/NUMBER")] = None,
    name: str = "faults",
    jobs: int = 1,
    docs: bool = False,
) -> None:
    """Put faults into every follower's command and sensor, and tell who is to blame for what they do.

    Args:
        controllers: names; without any, all that are shipped, policies too.
        faults: of all controllers and scenarios together, at least so many.
        seed: of the faults.
        quick: three controllers, few faults.
        case: tell one fault from period to period instead.
        name: of the folder in runs/.
        jobs: processes.
        docs: write the tables into docs/faults.md, too.
    """
    if case is not None:
        for sheet in story(case, seed):
            sheet.show()
        return
    if faults < 1:
        raise InvalidInput(f"--faults {faults} is out of range; at least 1")
    chosen = controllers or (QUICK[0] if quick else tuple(grids.shipped("following")))
    wanted = min(faults, QUICK[1]) if quick else faults
    words = [*(["--quick"] if quick else []), "--faults", str(faults), "--seed", str(seed)]
    words += ["--controllers", *controllers] if controllers else []
    folder = runs.open_folder(runs.named(name), overwrite=True)
    made(chosen, wanted, seed, folder, words, jobs, PAGE if docs else None)


if __name__ == "__main__":
    script.run(main, MODULE)
