"""What this cannot tell you."""

from ...envs.plant.sheet import FOOTPRINT
from ...envs.scenarios import SPLITS
from ...envs.scenarios.material import material
from .suite import Suite


def sentences(suites: list[Suite], learned: list[str]) -> list[tuple[str, str]]:
    """What the run's figures do not show: what it is about, and why.

    Args:
        suites: of the run.
        learned: labels of controllers that were trained.
    """
    followers, jobs = [s for s in suites if not s.jobs], [s for s in suites if s.jobs]
    labels = list(dict.fromkeys(label for s in jobs for label in s.results.labels))
    if followers:
        labels = list(dict.fromkeys([material("thin-sheet").label, *labels]))
    seeds = min(len(s.seeds) for s in suites)
    out = [
        ("No machine has been near this.", "All of it is simulation. Nothing here has been validated on a real "
         "machine, and numbers of the model that are marked [A] in its source are assumptions, neither measured nor "
         "published. Controllers whose figures are near one another may swap places if those are wrong."),
        ("The true gap cannot be seen on a machine.", "Scores are of the true gap. A real machine knows the reported "
         "height only, so it could not measure this score, and a slow filter looks better in its report than it is."),
        ("Dross and roughness are proxies.", "They follow the trends known of laser cuts; heat that builds up in "
         f"corners, shocks of the gas and striations as such are not in the model. {'; '.join(labels)}. Calibrated is "
         "not validated: a fit to published numbers says nothing of numbers that were not published. Figures of cuts "
         "with other settings than those, or of materials with assumed coefficients, are extrapolated: they are shown, "
         "but not ranked."),
        ("Intervals are about the draw of seeds.", f"They hold for other machines, sheets and noise of the same kind, "
         f"drawn as these {seeds} were. They know nothing of errors of the model, of other scenarios, or of another "
         "tuning of the same controller."),
        ("The gap is the mean under the nozzle.", footprints(suites)),
    ]  # fmt: skip
    if followers:
        out += [
            ("The axes are ideal in the following suites.", f"{feeds(suites)} The axes are where the path says. Jobs "
             "have axes with following error."),
            ("Ms and the margins are measured, not proved.", "Worst of the corner plants of the machines that were "
             "run; Ms with a sine of 20 µm, one frequency at a time, and with noise of 20 µm RMS; the margins with a "
             "step of 0.1 mm. Where friction, limits and thresholds act, another amplitude gives another figure."),
            ("Presets were tuned on tune seeds.", f"Those of the tune split ({SPLITS['tune'][0]} to "
             f"{SPLITS['tune'][-1]}), on the same family of sheets and plants. Another controller may gain as much "
             "from tuning; only equal budgets compare laws."),
        ]  # fmt: skip
    if jobs:
        said = "So a feed override comes into force 5 ms after it was decided; a machine with a longer buffer would do "
        said += "worse with what decides late."
        out.append(("The interpolator runs 5 ms ahead.", said))
    if learned:
        said = (
            f"{', '.join(learned)}: the interval does not hold the luck of the training seed. Another training of the "
        )
        said += "same recipe may end elsewhere."
        out.append(("A learned policy is one training.", said))
    return out


def footprints(suites: list[Suite]) -> str:
    """Over what score and sensor take the gap, as it was in the scenarios that were run."""
    score = f"The score is of the mean over ±{FOOTPRINT:g} mm under the tip."
    plates = sorted({float(plate) for s in suites for plate in s.results.meta.get("plates", ())})
    if not plates:
        return f"{score} Over how much the sensor's plate takes it, this run did not record."
    if plates == [FOOTPRINT]:
        return (
            f"{score} The sensor takes it over the same; only holes and edges are felt wider. A real head feels "
            "ripples shorter than its plate less than is assumed here."
        )
    words = " or ".join(f"{plate:g}" for plate in plates)
    return (
        f"{score} The sensor takes it over a plate of {words} mm radius, so it feels short ripples less than they are."
    )


def feeds(suites: list[Suite]) -> str:
    """Whether the feed changed in the followers' scenarios that were run."""
    known = [s.results.meta["corners"] for s in suites if not s.jobs and "corners" in s.results.meta]
    slow = list(dict.fromkeys(name for names in known for name in names))
    if not known:
        return "This run did not record in which scenarios the feed changes."
    if not slow:
        return "Constant feed, no slow-down in corners, also along a drawing."
    return f"The feed falls in corners in {', '.join(slow)}, and is constant in all others, also along a drawing."
