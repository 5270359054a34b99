"""The shipped presets of followers, all by one protocol: ``python -m kerfgym.experiments.tune.protocol``.

Minimised is the geometric mean of the RMS true error over the suite's core, under a cap on Ms and without collisions.
Every stack is given the same:

- *searched set*: all that its law declares and all that its filter's kind reads, within the declared ranges (windows up
  to 15, trims up to 3, bridges up to 10 samples);
- *trials*: :data:`TRIALS`, the first of which is the stack as it stands. TPE explores, then CMA-ES is started twice
  from the best so far, first with a narrow, then with a wide spread (docs/design.md#searching). A search
  that starts from a preset found on the same suite goes on from it, and its record counts both (``start``);
- *seeds*: :data:`SEEDS` tune seeds for each scenario and trial; a scenario of minutes takes a tenth of them;
- *final check*: the best :data:`CHECKED` on :data:`MORE_SEEDS` tune seeds, and Ms at the suite's frequencies. Few seeds
  flatter a candidate that fails one time in a hundred.

Ms at all frequencies is measured besides, of candidates that may come out best. How many those are is luck, so the
record has these steps apart from those that are compared as budgets.

What is not shipped is tuned with ``kerfgym tune``, which has the same roll-outs and more to choose from.
"""

import argparse
import math
import os
import platform
import subprocess
import time
from pathlib import Path
from typing import Any

from ... import __version__, baselines
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.plant import filters
from . import evaluate, goals

SUITE = "following"

TRIALS, EXPLORE = 240, 1 / 3
"""Trials of each search, and the share that TPE makes. CMA-ES makes the others, half of them after its restart."""

SPREADS = (0.1, 0.25)
"""Initial standard deviation of both starts of CMA-ES, in ranges."""

SEEDS = 16
"""Tune seeds per scenario and trial."""

CHECKED, MORE_SEEDS = 10, 200
"""How many of the best are checked in the end, and on how many tune seeds per scenario."""

CAP = 2.0
"""Largest Ms of what is searched, the usual limit of a design."""

CLOSE = 1.03
"""Over the best score so far; Ms of what is closer is measured at all frequencies."""

NAMES = (
    "xi2023-tuned", "pid", "observer", "lqg", "mpc", "self-tuning", "cn102528288a-tuned", "patent2022-free",
    "plasma-style", "preview-5ms", "oracle",
)  # fmt: skip
"""Followers with a preset."""

READS = {
    filters.MEAN: ("window",), filters.IMPROVED: ("window", "trim"), filters.WEIGHTED: ("window", "ratio"),
    filters.MEDIAN: ("window",), filters.LAG: ("tau",), filters.ANTI_IMPULSE: ("jump", "hold"),
    filters.KALMAN: ("trust",),
}  # fmt: skip
"""Settings that each kind of filter reads."""

COUNTED = ("trials", "simulated_steps", "ms_steps", "cpu_seconds", "git", "start")
"""Of an earlier search's record, what one that goes on from it keeps."""

UNFILTERED = ("self-tuning",)
"""Stacks whose law reads the raw height; their filter serves the supervisor alone."""

NARROWED = {"filter.window": (1, 15), "filter.trim": (0, 3), "filter.hold": (0, 10)}
"""Ranges of the search that are narrower than the declared ones."""


def space(stack: Stack) -> tuple[str, ...]:
    """What is searched of a stack: all of its law, and all that its filter reads."""
    known = stack.parameters()
    kind = known["filter.kind"].value
    read = [f"filter.{name}" for name in READS.get(kind, ())] if stack.name not in UNFILTERED else []
    return (*read, *(name for name in known if name.startswith("law.")))


class Evaluator:
    """Scores stacks of one law on the tune seeds of a suite's core, on the fleets of :mod:`experiments.tune`."""

    def __init__(self, stack: Stack, suite: str = SUITE, seeds: int = SEEDS, threads: int = 1) -> None:
        self.suite, self.seeds, self.ms_steps = suite, seeds, 0
        self._runs = evaluate.Evaluator(stacks.asked(stack), suite, range(seeds), threads)

    @property
    def steps(self) -> int:
        """Simulated so far, but for those of :meth:`exact_peak`, which are ``ms_steps``."""
        return self._runs.ledger.steps - self.ms_steps

    def score(self, stack: Stack) -> tuple[float, int]:
        """Geometric mean over the core scenarios of the RMS true error, µm (infinite if a run fails), collisions."""
        figures = self._runs.whole(stacks.asked(stack), ("rms_true", "collision"))
        score = goals.score("rms_true", figures, self._runs.core)
        collisions = sum(int(each["collision"].sum()) for each in figures.values())
        return (score if math.isfinite(score) else math.inf), collisions

    def peak(self, stack: Stack) -> float:
        """Ms on a coarser set of frequencies than the suite's, quick enough for a search."""
        return self._runs.peak(stacks.asked(stack))

    def exact_peak(self, stack: Stack) -> float:
        """Ms as a benchmark measures it."""
        before = self._runs.ledger.steps
        found = self._runs.exact_peak(stacks.asked(stack))
        self.ms_steps += self._runs.ledger.steps - before
        return found


def search(name: str, trials: int = TRIALS, cap: float = CAP, seed: int = 0) -> tuple[Stack, dict]:
    """The best stack found and the record of the search.

    Args:
        name: of :data:`NAMES`.
        trials: evaluations in all.
        cap: largest Ms allowed, checked at the suite's frequencies for the result.
        seed: of the samplers.

    Raises:
        RuntimeError: no trial keeps the cap without a collision.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    base, start = stacks.get(name), time.process_time()
    evaluator = Evaluator(base)
    searched = space(base)

    done: list[Any] = []

    def rank(trial: Any) -> float:
        seen = trial.user_attrs
        fits = seen.get("peak", math.inf) <= 1.005 * cap and seen.get("collisions", 1) == 0
        return seen["score"] if fits else math.inf

    def objective(trial: Any, exploring: bool) -> float:
        try:
            candidate = base.varied(_suggest(trial, base, searched))
        except InvalidInput:  # the trim eats the window
            return 20.0
        (score, collisions), peak = evaluator.score(candidate), evaluator.peak(candidate)
        # Between the few frequencies |S| may be much higher, which is worth knowing of those that may come out best.
        best = min((rank(each) for each in done + trial.study.trials), default=math.inf)
        if peak <= cap and not collisions and score < CLOSE * best:
            peak = max(peak, evaluator.exact_peak(candidate))
        trial.set_user_attr("score", score)
        trial.set_user_attr("peak", peak)
        trial.set_user_attr("collisions", collisions)
        if not (math.isfinite(score) and math.isfinite(peak)):
            return 15.0
        # Soft while exploring, so that good regions just beyond the cap are found; hard when it counts.
        weight = 2.0 if exploring else 12.0
        crashes = (0.1 + 0.01 * collisions) * bool(collisions)
        return math.log(score) + weight * max(0.0, math.log(peak / (0.98 * cap))) + crashes

    explore = round(EXPLORE * trials)
    sampler: Any = optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=30)
    study = optuna.create_study(sampler=sampler)
    # The stack as it stands is the first point, so a search never ends worse than it began.
    study.enqueue_trial({key: base.parameters()[key].value for key in searched})
    study.optimize(lambda trial: objective(trial, True), n_trials=explore)
    done += study.trials
    rest = [(trials - explore + 1) // 2, (trials - explore) // 2]
    for run, (spread, left) in enumerate(zip(SPREADS, rest, strict=True)):
        best = min(done, key=lambda t: (rank(t), t.value))
        sampler = optuna.samplers.CmaEsSampler(x0=best.params, sigma0=spread, seed=seed + run)
        study = optuna.create_study(sampler=sampler)
        study.optimize(lambda trial: objective(trial, False), n_trials=left)
        done += study.trials

    finalists: list[tuple[Stack, float, Any]] = []
    for trial in sorted((each for each in done if math.isfinite(rank(each))), key=rank):
        found = base.varied({k: _number(v) for k, v in trial.params.items()})
        peak = evaluator.exact_peak(found)
        if peak <= cap:
            finalists.append((found, peak, trial))
        if len(finalists) == CHECKED:
            break
    checker = Evaluator(base, seeds=MORE_SEEDS)
    checks = [checker.score(found) for found, _, _ in finalists]
    kept = [(score, at) for at, (score, collisions) in enumerate(checks) if not collisions and math.isfinite(score)]
    if not kept:
        raise RuntimeError(
            f"no trial of {name} keeps Ms ≤ {cap} and has no collision on {MORE_SEEDS} seeds: of {len(done)} trials "
            f"{len(finalists)} were checked, with {[collisions for _, collisions in checks]} collisions"
        )
    score, at = min(kept)
    found, peak, trial = finalists[at]
    return found, {
        "suite": suite_name(),
        "score_tune_um": round(trial.user_attrs["score"], 4), "ms": round(peak, 4),
        "collisions_tune": trial.user_attrs["collisions"],
        "checked_on": f"0-{MORE_SEEDS - 1}", "score_checked_um": round(score, 4),
        "cap": cap, "trials": trials, "searched": len(searched),
        "sampler": f"TPE {explore}, then CMA-ES {rest[0]} and {rest[1]}", "sampler_seed": seed,
        "tune_seeds": f"0-{evaluator.seeds - 1}", "simulated_steps": evaluator.steps + checker.steps,
        "ms_steps": evaluator.ms_steps, "cpu_seconds": round(time.process_time() - start, 1),
        "kerfgym": __version__, "git": _git(), "python": platform.python_version(), **_began(base),
    }  # fmt: skip


def _began(base: Stack) -> dict[str, Any]:
    """What the preset that a search starts from had been searched with; nothing if that was on another suite."""
    earlier = base.provenance
    if earlier.get("suite") != suite_name():
        return {}
    return {"start": {key: earlier[key] for key in COUNTED if key in earlier}}


def suite_name() -> str:
    """The suite and its version, as records have it."""
    return f"{SUITE}-{scenarios.rules(SUITE)['version']}"


def _suggest(trial: Any, base: Stack, searched: tuple[str, ...]) -> dict[str, float]:
    known, chosen = base.parameters(), {}
    for key in searched:
        q = known[key].quantity
        low, high = NARROWED.get(key, (q.low, q.high))
        if q.whole:
            chosen[key] = float(trial.suggest_int(key, int(low), int(high)))
        else:
            chosen[key] = trial.suggest_float(key, low, high, log=q.log)
    return chosen


def _number(value: float) -> float:
    return float(f"{float(value):.5g}")


def _git() -> str:
    try:
        out = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent
        )
    except OSError:
        return "unknown"
    return out.stdout.strip() or "unknown"


def write_preset(stack: Stack, record: dict) -> Path:
    """Writes the preset of a shipped stack."""
    import tomli_w

    path = baselines.PRESETS / f"{stack.name}.toml"
    path.parent.mkdir(exist_ok=True)
    values = stack.parameters()
    body = {"parameters": {key: values[key].value for key in space(stack)}, "provenance": record}
    header = "# Found by: python -m kerfgym.experiments.tune.protocol " + stack.name + "\n"
    path.write_text(header + tomli_w.dumps(body), encoding="utf-8")
    return path


def make(name: str, trials: int = TRIALS) -> dict[str, Any]:
    """Searches one preset, writes it, and says what came out and what it cost; empty if nothing keeps the limits."""
    try:
        stack, record = search(name, trials)
    except RuntimeError as error:
        print(f"{name}: {error}; its preset stays as it is", flush=True)
        return {}
    path = write_preset(stack, record)
    print(
        f"{name}: {record['score_checked_um']} µm at Ms {record['ms']}, {record['searched']} numbers searched in "
        f"{record['simulated_steps']:,} steps and {record['cpu_seconds']} CPU-s → {path.name}",
        flush=True,
    )
    return record


def main() -> None:
    """Searches the presets named on the command line (all of them if none is)."""
    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(
        prog="python -m kerfgym.experiments.tune.protocol", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="searches at a time")
    parser.add_argument("--trials", type=int, default=TRIALS, help=f"of each search ({TRIALS})")
    asked = parser.parse_args()
    if asked.trials < 10:
        parser.error(f"--trials {asked.trials} is out of range; at least 10")
    for name in asked.names:
        if name not in NAMES:
            parser.error(f"unknown preset '{name}'; {did_you_mean(name, NAMES)}")
    records = Parallel(n_jobs=asked.jobs)(delayed(make)(name, asked.trials) for name in asked.names or NAMES)
    made = [record for record in records if record]
    steps, seconds = (sum(record[key] for record in made) for key in ("simulated_steps", "cpu_seconds"))
    print(f"{len(made)} of {len(records)} presets: {steps:,} simulated steps, {seconds:,.0f} CPU-s")
    if len(made) < len(records):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
