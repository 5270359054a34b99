"""``python -m kerfgym.experiments.faults``; see the package's text."""

from typing import Annotated

import tyro

from ...envs import scenarios
from ...envs.plant.quantity import InvalidInput
from .. import grids, pages, runs
from ..bars import progress
from .campaign import SCENARIOS, campaign
from .story import story
from .tables import MODULE, harmed, sheets

QUICK = (("xi2023-tuned", "lqg", "self-tuning"), 240)
"""Controllers and faults of ``--quick``."""


def main(
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = (), faults: int = 12000, seed: int = 0,
    quick: bool = False, case: Annotated[str | None, tyro.conf.arg(metavar="CONTROLLER/SCENARIO/NUMBER")] = None,
    name: str = "faults", jobs: int = 1, docs: bool = False,
) -> None:  # fmt: skip
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
    folder = runs.open_folder(runs.named(name), overwrite=True)
    cost = pages.Cost(jobs)
    with progress("faults") as told:
        frame = campaign(chosen, wanted, seed, jobs, told)
    words = ["python", "-m", MODULE, *(["--quick"] if quick else []), "--faults", str(faults), "--seed", str(seed)]
    words += ["--controllers", *controllers] if controllers else []
    record = runs.record(words) | {
        **cost.record(), "seed": seed, "controllers": list(chosen), "scenarios": list(SCENARIOS), "faults": len(frame),
        "seeds": f"test, from {scenarios.SPLITS['test'].start} on", "lost": int(frame["lost"].sum()),
        "lost_by": frame["cause"].value_counts().drop("", errors="ignore").to_dict(), "harmed": len(harmed(frame)),
    }  # fmt: skip
    runs.write_table(folder, "faults", frame)
    pages.publish(folder, record, sheets(frame, seed), MODULE, "faults" if docs else None)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except InvalidInput as error:
        raise SystemExit(f"kerfgym: {error}") from None
