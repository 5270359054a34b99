"""Wu: the sampled position loops' stability, lag, distortion and accuracy."""

from ...envs.plant import xy_axes
from .claims import Estimate, Findings, Row, Trial, judged, study

PRESETS = {
    "a": xy_axes.Params(),
    "b": xy_axes.Params(t1=0.012, t2=0.006626, tau=0.0, gain=1.04167),
}
"""Drive constants that agree with the printed limit (PHYSICS §3); Wu gives none."""

KN = 0.2


@study("wu", "Stability of the position loop")
def stability(trial: Trial) -> Findings:
    """The largest gain Kp of the literal and of the physical loop."""
    rows = []
    for name, p in PRESETS.items():
        for literal in (True, False):
            limit = xy_axes.largest_gain(p._replace(literal=literal)) / (KN * p.gain)
            mode = "sums sampled speeds, as printed" if literal else "integrates its velocity"
            rows.append(Row(
                "§4", f"stable for Kp below, constants ({name}), {mode}", "4.5", Estimate(limit, digits=4),
                judged(literal and abs(limit - 4.5) < 0.01, "calibrated"),
                "the drive's constants are not printed; they were chosen so that this limit results" if literal else
                "a slide that integrates its velocity between the servo instants becomes unstable earlier",
            ))  # fmt: skip
    return Findings(rows)
