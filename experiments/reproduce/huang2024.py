"""Huang2024: path, dither and cut quality."""

import functools
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import BSpline, CubicSpline
from scipy.special import comb

from ...baselines import preset
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import job_metrics, quality
from ...envs.paths import bspline
from ...envs.plant import cut, gantry, spot
from ...envs.scenarios import material as materials
from ..plots.palette import COLOURS, GRID, QUIET
from ..results import jobs
from . import fit_cut
from .claims import Rows, Trial, estimate, study
from .pictures import Drawing, illustrated

METHODS = {
    "static, surface quality": "huang2024-static-quality",
    "static, fastest": "huang2024-static-fast",
    "dynamic compound": "huang2024-dynamic",
}
"""The methods of Table 2 by the names of ``calibrate.TABLE_2``, and the stacks that do them."""

DYNAMIC = spot.Command(frequency=2000.0, x=0.3, y=0.3, z=1.0)
"""Table 1: thin stock."""

GRAVITY = 9806.65
"""mm/s²"""

# -------------------------------------------------------------------------------------------------- optics (§1, §2)


@study("huang2024", "Power, speed and angles: eqs. 1, 2, 9–11")
def equations(trial: Trial, rows: Rows) -> None:
    """The equations of §2 against integrals, derivatives and dimensions."""
    steel = materials.material("c45-10")
    w0, p0 = steel.params.w0, steel.power
    delta = float(cut.absorptivity(steel.params, 2.0 * w0))
    area = np.pi * w0**2
    i0 = delta * p0 / area
    # Power of a spot from its intensity, on rings.
    r = np.linspace(0.0, 8.0 * w0, 200_001)
    uniform = float(np.trapezoid(np.where(r <= w0, i0, 0.0) * 2 * np.pi * r, r)) / delta
    gaussian = float(np.trapezoid(i0 * np.exp(-2.0 * (r / w0) ** 2) * 2 * np.pi * r, r)) / delta
    error = 100 * (uniform / p0 - 1)
    rows("spot-power", (uniform, p0, i0 * 1e-3, delta, 1e3 * w0), error=error, guess=100 * (4 / np.pi - 1))
    rows("gaussian-peak", (gaussian, p0), holds=abs(gaussian / p0 - 1) < 0.05)
    fast = jobs_of("huang2024-static-fast", "cut-square", trial.seeds)
    kerf = estimate(fast["kerf"], "mm")
    holds = abs(kerf.value / (2 * w0) - 1) < 0.1
    rows("kerf-width", (kerf, 2 * w0, 2 * w0 * np.hypot(1, steel.params.focus / steel.params.zr)), holds)
    amplitude, frequency = DYNAMIC.x, DYNAMIC.frequency
    t = np.linspace(0.0, 4.0 / frequency, 40_001)
    x, _, _ = spot.offsets(spot.Params(), spot.Realised(frequency, amplitude, amplitude, 1.0), t * frequency)
    peak = float(np.abs(np.gradient(x, t)).max())
    holds = abs(peak / (amplitude * frequency) - 1) < 0.05
    rows("spot-speed", (peak, amplitude * frequency, 4 * amplitude * frequency), holds)
    _eq_9(rows)
    _eqs_10_11(rows)


def _eq_9(rows: Rows) -> None:
    beta = np.linspace(0.0, np.pi / 2, 91)
    depth, width = 0.8, 1.0
    _, theta = spot.angles(depth, width, beta)
    # The triangle with angles α, β and π − θ: sides by the law of sines close by the law of cosines.
    third = np.sqrt(depth**2 + width**2 - 2 * depth * width * np.cos(np.pi - theta))
    inner = beta > 0.01
    closed = float(np.abs(width / np.sin(beta[inner]) - third[inner] / np.sin(np.pi - theta[inner])).max())
    try:
        spot.angles(1.2, 1.0, np.pi / 2)
        refused = False
    except InvalidInput:
        refused = True
    loose = beta[inner] * (1 + depth / width)
    side = np.sqrt(depth**2 + width**2 - 2 * depth * width * np.cos(np.pi - loose))
    small = float(np.abs(width / np.sin(beta[inner]) - side / np.sin(np.pi - loose)).max())
    rows("eq-9", closed, error=closed if refused else np.inf, guess=small)


def _eqs_10_11(rows: Rows) -> None:
    """Dimensions (mm, s, W) of the two sides."""
    length, speed, intensity = np.array([1.0, 0, 0]), np.array([1.0, -1, 0]), np.array([-2.0, 0, 1])
    for where, power_of, text in (("eq. 10", 3, "sin θ"), ("eq. 11", 2, "cos θ")):
        left = length - 0.5 * (power_of * intensity + speed)
        unit = " · ".join(f"{u}^{e:g}" for u, e in zip(("mm", "s", "W"), left, strict=True) if e)
        rows("eqs-10-11", (unit.replace("-", "−"), text, power_of), np.allclose(left, 0.0), where=where, case=where)


# ------------------------------------------------------------------------------------------------- B-spline (§2.2)


def printed_basis(t: np.ndarray) -> np.ndarray:
    """Eq. 5 as printed, with its two misprints, shape (len(t), 4)."""
    first, last = (-(t**3) + 3 * t**2 - 3 * t + 1) / 6, t**3 / 6
    middle = ((3 * t**2 - 6 * t**2 + 4) / 6, (-3 * t**3 - 3 * t**2 + 3 * t + 1) / 6)
    return np.stack([first, *middle, last], axis=1)


def general_basis(t: np.ndarray, k: int = 3) -> np.ndarray:
    """Eq. 4: 1/k!·Σ (−1)^r·C(k+1, r)·(t + k − i − r)^k over r ≤ k − i, shape (len(t), k + 1)."""
    factorial = float(np.prod(np.arange(1, k + 1)))
    sums = [sum((-1) ** r * comb(k + 1, r) * (t + k - i - r) ** k for r in range(k - i + 1)) for i in range(k + 1)]
    return np.stack([one / factorial for one in sums], axis=1)


MATRIX = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]])
"""Eq. 6 as printed: [1 t t² t³]/6 times this."""


@study("huang2024", "Cubic B-spline: eqs. 3–8")
def b_spline(trial: Trial, rows: Rows) -> list[Drawing]:
    """The printed and the corrected basis, matrix form, ends, tangents, and local control."""
    t = np.linspace(0.0, 1.0, 101)
    ours, printed = bspline.basis(t), printed_basis(t)
    whole, misses = float(np.abs(ours.sum(axis=1) - 1).max()), float(np.abs(printed.sum(axis=1) - 1).max())
    wrong = [i for i in range(4) if np.abs(ours[:, i] - printed[:, i]).max() > 1e-9]
    general = float(np.abs(general_basis(t) - ours).max())
    matrix = float(np.abs(np.stack([t**0, t, t**2, t**3], axis=1) @ MATRIX / 6 - ours).max())
    misprint = float(np.abs(printed - ours).max())
    c = np.array([[0.0, 0.0], [8.0, 14.0], [22.0, 15.0], [30.0, 2.0]])
    curve = ours @ c
    wanted = np.array([c[0] + 4 * c[1] + c[2], c[1] + 4 * c[2] + c[3]]) / 6
    ends = float(np.abs(curve[[0, -1]] - wanted).max())
    slope = BSpline(np.arange(-3, 5), c, 3).derivative()(np.array([0.0, 1.0]))
    tangents = float(np.abs(slope - np.array([c[2] - c[0], c[3] - c[1]]) / 2).max())
    many = np.random.default_rng(0).uniform(-10, 10, (12, 2))
    sampled = bspline.sampled(many, 50)
    theirs = BSpline(np.arange(-3, len(many) + 1), many, 3)(np.linspace(0.0, len(many) - 3.0, len(sampled)))
    scipys = float(np.abs(sampled - theirs).max())
    moved = many.copy()
    moved[5] += 1.0
    shifted = np.flatnonzero(np.abs(bspline.sampled(moved, 50) - sampled).max(axis=1) > 1e-12)
    segments = len(np.unique(shifted[shifted % 50 != 0] // 50))  # where they meet, a point is of two
    # An interpolating spline through the same points: a point that moves bends all of it.
    knots, fine = np.arange(len(many)), np.linspace(0.0, len(many) - 1.0, 50 * (len(many) - 1) + 1)
    bent = np.abs(CubicSpline(knots, moved)(fine) - CubicSpline(knots, many)(fine)).max(axis=1) > 1e-12
    every = len(np.unique(np.flatnonzero(bent)[np.flatnonzero(bent) % 50 != 0] // 50)) / (len(many) - 1)
    polygon = np.stack([np.interp(np.linspace(1.0, len(many) - 2.0, len(sampled)), knots, m) for m in many.T], axis=1)
    rows("printed-basis", (misses, " and N".join(str(i) for i in wrong)), holds=misses < 1e-9)
    rows("corrected-basis", whole, holds=whole < 1e-12)
    rows("general-basis", general, error=general, guess=misprint)
    rows("matrix", matrix, error=matrix, guess=misprint)
    rows("segment-ends", ends, error=ends, guess=float(np.abs(wanted - c[1:3]).max()))
    guess = float(np.abs(slope - np.array([c[1] - c[0], c[3] - c[2]])).max())
    rows("end-tangents", tangents, error=tangents, guess=guess)
    rows("uniform-spline", (scipys, len(many)), error=scipys, guess=float(np.abs(polygon - theirs).max()))
    error = segments / (len(many) - 3)
    rows("local-control", (segments, len(many) - 3), error=error, guess=every, tolerance=4 / (len(many) - 3))

    @illustrated("Huang2024 Fig. 2", 2)
    def b_spline(left: Axes, right: Axes) -> None:
        """Left: a segment with its control polygon; right: its basis. Dotted: as printed; that curve runs off the
        polygon, since its basis does not sum to 1."""
        left.plot(*c.T, "o--", color=QUIET, lw=1.0, ms=5, label="control polygon")
        left.plot(*curve.T, color=COLOURS[0], lw=2.0, label="corrected basis")
        left.plot(*(printed @ c).T, color=COLOURS[1], ls=":", label="eq. 5 as printed")
        for i, (x, y) in enumerate(c):
            left.annotate(f"C{i}", (x, y), textcoords="offset points", xytext=(6, 4), color=QUIET)
        left.set(xlabel="x, mm", ylabel="y, mm", xlim=(-4, 36), ylim=(-4, 20))
        left.legend(frameon=False, fontsize=8, loc="lower center")
        for i in range(4):
            right.plot(t, ours[:, i], color=COLOURS[i], label=f"N{i}")
            if i in wrong:
                right.plot(t, printed[:, i], color=COLOURS[i], ls=":")
        right.plot(t, printed.sum(axis=1), color=QUIET, ls=":", label="sum, printed")
        right.plot(t, ours.sum(axis=1), color=QUIET, label="sum, corrected")
        right.set(xlabel="parameter t, 1", ylabel="basis, 1")
        right.legend(frameon=False, ncols=2, fontsize=8)

    return [b_spline()]


# ------------------------------------------------------------------------------------------------------ dither (§3)


def printed_dither(shape: str, t: np.ndarray, sizes: tuple[float, float, float, float]) -> np.ndarray:
    """Eq. 12 as printed, ``M·[t, sin t, cos t]``, shape (3, len(t)); ``sizes``: a, b, c, d (r = a, of a circle)."""
    a, b, c, d = sizes
    s, k, zero = np.sin(t), np.cos(t), np.zeros_like(t)
    if shape == "circular":
        return np.array([a * k, a * s, 2 * t + zero])
    if shape == "hat":
        return np.array([a * s + b * t * k, -d * t * s + c * k, t])
    return np.array([a * k, b * s, 2 * t + zero])


@study("huang2024", "Dither: eqs. 12 and 13, three shapes")
def dither(trial: Trial, rows: Rows) -> list[Drawing]:
    """The shapes as printed and as the machine makes them; the compound trajectory of a recorded cut."""
    still = spot.Realised(2000.0, 0.3, 0.3, 1.0)  # optics that follow at once
    for shape, turns, sizes in (
        ("circular", 2.0, (0.3, 0.3, 0.0, 0.0)),
        ("hat", 2.5, (0.06, 0.24 / (5 * np.pi), 0.06, 0.24 / (5 * np.pi))),
        ("elliptical", 2.0, (0.3, 0.15, 0.0, 0.0)),
    ):
        u = np.linspace(0.0, turns, 2001)
        real = still._replace(y=0.15) if shape == "elliptical" else still
        made = np.array(spot.offsets(spot.Params(shape=spot.SHAPES.index(shape)), real, u))
        wanted = printed_dither(shape, 2 * np.pi * u, sizes)
        apart = float(np.abs(made[:2] - wanted[:2]).max())
        said = "apart by less than 1 pm" if apart < 1e-9 else f"apart by {1e3 * apart:.2g} µm"
        wrong = "circular" if shape != "circular" else "elliptical"
        guess = printed_dither(wrong, 2 * np.pi * u, (0.3, 0.15, 0.0, 0.0))
        rows("helix", (said, shape), error=apart, guess=float(np.abs(made[:2] - guess[:2]).max()), case=shape)
    grown = 2 * 2 * np.pi * 2000.0
    far = float(np.abs(spot.offsets(spot.Params(), still, np.linspace(0.0, 4.0, 4001))[2]).max())
    rows("unbounded-ramp", (far, grown * 1e-3), holds=abs(far / grown - 1) < 0.1)
    _eq_13(rows)
    return [_dither_shapes(), _compound()]


def _recorded(name: str, scenario: str, seed: int = 1000) -> np.ndarray:
    """Channels of one job."""
    _, _, channels = jobs.roll(scenarios.load(scenario), stacks.team(stacks.resolve(name)), [seed], record=True)
    assert channels is not None
    return channels[:, :, 0]


def _eq_13(rows: Rows) -> None:
    """Eq. 13 on a recorded cut: what the spot does beside the carrier is the dither."""
    channels, optics = _recorded("huang2024-dynamic", "cut-square"), spot.Params()
    whole = quality.travelled(channels, optics, 1.0)
    c = {name: channels[:, i].astype(float) for i, name in enumerate(gantry.CHANNELS)}
    on = np.flatnonzero((c["phase"] == gantry.LEAD_IN) | (c["phase"] == gantry.CUT))
    ms, t = np.arange(len(on), dtype=float), np.arange(len(whole.along)) * whole.dt * 1e3
    relative = np.array([whole.along - np.interp(t, ms, c["s"][on]), whole.across - np.interp(t, ms, c["error"][on])])
    radius = np.hypot(*relative)
    real = spot.realised(optics, DYNAMIC, 0.0)
    off = np.abs(radius - real.x)
    spectrum = np.abs(np.fft.rfft(relative[1] * np.hanning(len(radius))))
    frequency = float(np.fft.rfftfreq(len(radius), whole.dt)[np.argmax(spectrum)])
    told = (float(np.median(radius)), DYNAMIC, len(radius), 1e3 * np.quantile(off, 0.99), 1e3 * off.max())
    rows("relative-dither", told, holds=abs(np.median(radius) / DYNAMIC.x - 1) < 0.05)
    rows("dither-frequency", frequency * 1e-3, holds=abs(frequency / 2000.0 - 1) < 1e-3)


@illustrated("Huang2024 Fig. 4, eq. 12", 0, layout=None)
def _dither_shapes(figure: Figure) -> None:
    """Dither as printed: t from 0 to 4π, 10π and 4π. Circle of 0.3 mm; hat with a = c = 0.06 mm and b = d = 0.008 mm;
    ellipse of 0.3 and 0.15 mm. The machine folds z to ±1 mm."""
    cases = (
        ("circular", 4 * np.pi, (0.3, 0.3, 0.0, 0.0)),
        ("hat", 10 * np.pi, (0.06, 0.008, 0.06, 0.008)),
        ("elliptical", 4 * np.pi, (0.3, 0.15, 0.0, 0.0)),
    )
    for i, (shape, end, sizes) in enumerate(cases):
        ax: Any = figure.add_subplot(1, 3, i + 1, projection="3d")
        x, y, z = printed_dither(shape, np.linspace(0.0, end, 1500), sizes)
        ax.plot(x, y, z / z.max(), color=COLOURS[i], lw=1.2)
        ax.set_title(f"({'abc'[i]}) {shape}", fontsize=9)
        ax.set_xlabel("x, mm", fontsize=8, labelpad=2)
        ax.set_ylabel("y, mm", fontsize=8, labelpad=2)
        ax.set_zlabel("z of its stroke, 1", fontsize=8, labelpad=0)
        ax.tick_params(labelsize=7, pad=0)
        ax.set(xlim=(-0.32, 0.32), ylim=(-0.32, 0.32), xticks=(-0.3, 0, 0.3), yticks=(-0.3, 0, 0.3), zticks=(0, 0.5, 1))
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.pane.fill = False
        ax.set_box_aspect(None, zoom=0.95)
    figure.subplots_adjust(left=0.0, right=0.94, bottom=0.04, top=0.98, wspace=0.14)


@illustrated("Huang2024 Fig. 5, eq. 13", 4, 2, 4.2, sharex=True, gridspec_kw={"height_ratios": (2, 1)})
def _compound(*axes: Axes) -> None:
    """5 ms (ten turns at 2 kHz) of the spot while the carrier advances 83 µm at 1 m/min: seen from above and from the
    side. Amplitudes 0.3 mm (ellipse: 0.15 mm across) and ±1 mm of focus, as the optics realise them."""
    grid = np.reshape(np.array(axes, object), (2, 4))
    feed, optics = 1000.0 / 60, spot.Params()
    t = np.linspace(0.0, 5e-3, 4001)
    for i, shape in enumerate(("none", *spot.SHAPES)):
        on = shape != "none"
        size = DYNAMIC._replace(y=0.15 if shape == "elliptical" else 0.3) if on else spot.Command()
        real = spot.realised(optics, size, 0.0)
        own = optics._replace(shape=spot.SHAPES.index(shape)) if on else optics
        x, y, z = spot.offsets(own, real, t * real.frequency) if on else np.zeros((3, len(t)))
        for ax, value in zip(grid[:, i], (y, z), strict=True):
            ax.plot(feed * t + x, value, color=COLOURS[i], lw=0.7)
        grid[0, i].set_title("direct cut" if not on else shape, fontsize=9)
        grid[0, i].set(ylim=(-0.36, 0.36), xlim=(-0.36, 0.45))
        grid[1, i].set(xlabel="along, mm", ylim=(-1.2, 1.2))
        for ax in grid[:, i]:
            ax.tick_params(labelsize=8)
            if i:
                ax.set_yticklabels([])
    grid[0, 0].set(ylabel="across, mm")
    grid[1, 0].set(ylabel="focus z, mm")


# ------------------------------------------------------------------------------------------------- tables 1 and 2


@study("huang2024", "Table 1: what the optics make of the settings")
def table_1(trial: Trial, rows: Rows) -> None:
    """Amplitudes behind galvo and piezo, and what a moving lens would have to stand."""
    optics = spot.Params()
    for kilohertz, stroke in ((2.0, 1.0), (4.0, 5.0)):
        hertz = 1e3 * kilohertz
        real = spot.realised(optics, spot.Command(frequency=hertz, x=0.3, y=0.3, z=stroke), 0.0)
        holds = abs(real.x / 0.3 - 1) < 0.05
        rows("galvo", (1e3 * real.x, kilohertz, np.rad2deg(real.lag), optics.galvo * 1e-3, optics), holds)
        holds = abs(real.z / stroke - 1) < 0.05
        rows("piezo", (real.z, kilohertz, stroke, np.rad2deg(real.lag_z), optics.piezo * 1e-3), holds)
        load = stroke * (2 * np.pi * hertz) ** 2 / GRAVITY
        rows("moving-lens", (load, stroke, kilohertz), holds=load < 1e3)


@functools.cache
def jobs_of(name: str, scenario: str, seeds: int, shape: str = "circular") -> dict[str, np.ndarray]:
    """Metrics of the jobs of a scenario under a stack of the slot ``process``, one value per test seed."""
    wanted = list(scenarios.SPLITS["test"])[:seeds]
    case = scenarios.load(scenario).varied(optics={"shape": shape})
    fleet, job, _ = jobs.roll(case, stacks.team(stacks.resolve(name)), wanted)
    return job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))


@study("huang2024", "Table 2: speed, dross and roughness of three methods")
def table_2(trial: Trial, rows: Rows) -> list[Drawing]:
    """The nine numbers from whole jobs (streaming form), from the full form, and the radar chart of Fig. 10."""
    steel = materials.material("c45-10")
    straight = fit_cut.table(steel.params, steel.power).set_index("method")
    figures = {}
    fitted = "six coefficients were fitted to these six numbers and the focus: agreement validates nothing"
    for method, name in METHODS.items():
        printed, seen = fit_cut.TABLE_2[method], jobs_of(name, "cut-square", trial.seeds)
        feed = estimate(0.06 * seen["mean_feed"], "m/min")
        dross, rough = estimate(seen["dross"], "mm"), estimate(1e-3 * seen["roughness"], "mm")
        figures[method] = (feed.value, dross.value, rough.value)
        rows("cutting-speed", (feed, method, printed), holds=abs(feed.value / printed["feed"] - 1) < 0.1)
        for text, found in (("dross", dross), ("roughness", rough)):
            short = "dross" if text == "dross" else "Rz"
            full = straight.loc[method, f"{short}, full"]
            iso = quality.iso_range(found.value, 10.0)
            holds = abs(found.value / printed[text] - 1) < 0.1
            rows("table-2", (found, method, text, printed[text], full, fitted, iso), holds, case=text)
    recorded = quality.evaluate(
        quality.travelled(_recorded("huang2024-dynamic", "cut-square"), spot.Params(), steel.power), steel.params
    ).means()
    holds = abs(recorded["dross"] / 0.9 - 1) < 0.1 and abs(recorded["roughness"] / 0.09 - 1) < 0.1
    rows("full-form", recorded, holds)
    v, d, r = (np.array([figures[m][i] for m in METHODS]) for i in range(3))
    right = bool(v[2] == v.max() and d[2] == d.min() and r[0] < r[2] < r[1])
    rows("best-of-three", holds=right, note=fitted, case="right" if right else "other")
    paper = {m: (row["feed"], row["dross"], row["roughness"]) for m, row in fit_cut.TABLE_2.items()}
    areas = [area(radar(values)) for values in (paper, figures)]
    lead = [a["dynamic compound"] / max(a["static, surface quality"], a["static, fastest"]) for a in areas]
    rows("radar", (float(lead[1]), lead, fitted), holds=lead[0] > 1 and lead[1] > 1)
    return [_radar(paper, figures)]


def radar(values: dict[str, tuple[float, float, float]]) -> dict[str, np.ndarray]:
    """Speed, dross and roughness of each method as shares of the best: v/v_best, d_best/d, r_best/r."""
    v, d, r = (np.array(column) for column in zip(*values.values(), strict=True))
    shares = np.stack([v / v.max(), d.min() / d, r.min() / r], axis=1)
    return dict(zip(values, shares, strict=True))


def area(shares: dict[str, np.ndarray]) -> dict[str, float]:
    """Area of each method's triangle, axes 120° apart."""
    return {m: float(np.sqrt(3) / 4 * (s * np.roll(s, 1)).sum()) for m, s in shares.items()}


@illustrated("Huang2024 Fig. 10, Table 2", 0, height=3.9)
def _radar(figure: Figure, paper: dict, simulated: dict) -> None:
    """Three methods; each axis is the share of the best of the three, outward is better: v/v_best, dross_best/dross,
    Rz_best/Rz (no unit). Calibrated to Table 2, so that the two agree proves nothing."""
    angles = np.pi / 2 + np.arange(4) * 2 * np.pi / 3
    for i, (title, values) in enumerate((("paper", paper), ("simulation", simulated))):
        ax: Any = figure.add_subplot(1, 2, i + 1, projection="polar")
        for (method, share), colour, style in zip(radar(values).items(), COLOURS, ("-", "--", "-."), strict=False):
            ax.plot(angles, np.append(share, share[0]), color=colour, ls=style, label=method)
            ax.fill(angles, np.append(share, share[0]), color=colour, alpha=0.08)
        ax.set_xticks(angles[:3], ["speed", "dross", "roughness"])
        ax.set(ylim=(0, 1), yticks=(0.25, 0.5, 0.75, 1.0))
        ax.set_yticklabels(["", "0.5", "", "1"], fontsize=8, color=QUIET)
        ax.grid(color=GRID)
        ax.set_title(title, fontsize=10)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)


# ------------------------------------------------------------------------------ what dither and its shapes are for


SAME = 0.5
"""m/min: feed at which cuts with and without dither are compared; the fastest of Table 2 without."""

DITHERS = {
    "none": ("huang2024-static-fast", "circular"),
    "circular": (f"huang2024-dynamic:plan.feed={SAME / 0.06:.6g}", "circular"),
    "hat": (f"huang2024-dynamic:plan.feed={SAME / 0.06:.6g}", "hat"),
    "elliptical": (f"huang2024-dynamic:plan.feed={SAME / 0.06:.6g},law.y=0.15", "elliptical"),
}
"""Stack and shape of each dither at that feed, ±0.3 mm (the ellipse ±0.15 mm in y), 2 kHz, ±1 mm of focus."""


def fastest(p: cut.Params, watts: float, dither: spot.Command) -> float:
    """The largest feed, m/min, at which a straight cut still goes through."""
    low, high = 0.01, 20.0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        through = fit_cut.streamed(p, watts, {"feed": middle, "dither": dither}).through > 0.5
        low, high = (middle, high) if through else (low, middle)
    return low


@study("huang2024", "Dither: absorption, speed, dross, roughness")
def absorption(trial: Trial, rows: Rows) -> list[Drawing]:
    """The four things that §4 says of cutting with dither, beside the same beam without, at the same power."""
    steel = materials.material("c45-10")
    amplitudes = np.linspace(0.0, 0.3, 31)
    beams = [fit_cut.beam_of(steel.params, steel.power, DYNAMIC._replace(x=a, y=a)) for a in amplitudes.tolist()]
    share = np.array([beam.absorbed for beam in beams])
    plain = float(fit_cut.beam_of(steel.params, steel.power, spot.Command()).absorbed)
    speeds = [fastest(steel.params, steel.power, d) for d in (spot.Command(), DYNAMIC)]
    pair = (DITHERS[name] for name in ("none", "circular"))
    without, with_ = (jobs_of(one, "cut-square", trial.seeds, other) for one, other in pair)
    rows("absorbed-share", (100 * plain, 100 * share[-1]), holds=share[-1] > 1.02 * plain)
    rows("largest-feed", (speeds, SAME), holds=speeds[1] > 1.02 * speeds[0])
    for name, unit, said in (("dross", "mm", "“smaller dross”"), ("roughness", "µm", "“improves roughness”")):
        a, b = without[name], with_[name]
        rows("same-feed", (estimate(a, unit), estimate(b, unit), name, SAME), holds=np.median(b / a) < 0.98, paper=said)

    @illustrated("Huang2024 §4", 2)
    def absorption(left: Axes, right: Axes) -> None:
        """Left: absorbed share over the amplitude of a circular dither, 2 kHz. Right: melt margin over the feed at the
        same power, a straight cut in C45 of 10 mm; below 1 (dashed) the beam does not cut through."""
        left.plot(amplitudes, 100 * share, color=COLOURS[0])
        left.plot([0.0], [100 * plain], "o", color=COLOURS[1], label="no dither")
        left.set(xlabel="amplitude of the dither in x and y, mm", ylabel="absorbed share of the power, %")
        left.set_ylim(0, None)
        left.legend(frameon=False)
        feeds = np.geomspace(0.1, 2.0, 40)
        for (label, dither), colour in zip(
            {"none": spot.Command(), "circle of 0.3 mm": DYNAMIC}.items(), (COLOURS[1], COLOURS[0]), strict=True
        ):
            margin = [
                fit_cut.streamed(steel.params, steel.power, {"feed": float(v), "dither": dither}).margin for v in feeds
            ]
            right.semilogx(feeds, margin, color=colour, label=label)
        right.axhline(1.0, color=QUIET, lw=0.8, ls="--")
        right.set(xlabel="feed, m/min", ylabel="melt margin, 1", ylim=(0, 4))
        right.legend(frameon=False)

    return [absorption()]


@study("huang2024", "What each shape of dither is said to be good for")
def shapes(trial: Trial, rows: Rows) -> list[Drawing]:
    """Circle, hat and ellipse at one feed and power, beside no dither and beside each other."""
    found = {name: jobs_of(stack, "cut-square", trial.seeds, shape) for name, (stack, shape) in DITHERS.items()}

    for key, figure, shape, beside in (
        ("shape-dross", "dross", "circular", "none"),
        ("shape-striations", "roughness", "circular", "none"),
        ("shape-section", "roughness", "hat", "none"),
        ("shape-inclination", "taper", "elliptical", "none"),
        ("shape-inclination", "taper", "elliptical", "circular"),
    ):
        a, b = found[beside][figure], found[shape][figure]
        unit = "µm" if figure == "roughness" else "mm"
        rows(key, (estimate(b, unit), estimate(a, unit), SAME), holds=np.median(b / a) < 0.98, case=beside)

    @illustrated("Huang2024 §3, eq. 12", 3, height=3.2, words={"SAME": f"{SAME:g}"})
    def shapes(*axes: Axes) -> None:
        """C45 of 10 mm, cut-square at {SAME} m/min and the same power: no dither and the three shapes, medians over the
        seeds. What the paper says of the ellipse is about the taper."""
        labels = {"taper": "taper u, mm", "roughness": "roughness Rz, µm", "dross": "dross, mm"}
        for ax, (name, label) in zip(axes, labels.items(), strict=True):
            ax.bar(list(found), [np.median(f[name]) for f in found.values()], color=[QUIET, *COLOURS[:3]])
            ax.set(ylabel=label)
            ax.tick_params(axis="x", labelrotation=30, labelsize=8)

    return [shapes()]


# --------------------------------------------------------------------------------------- Fig. 8, the adjusting unit


@study("huang2024", "Fig. 8: amplitude of the focus' dither")
def focus_dither(trial: Trial, rows: Rows) -> list[Drawing]:
    """Edge quality with ±1 mm at 2 kHz and ±5 mm at 4 kHz, on whole jobs and over the amplitude."""
    small, large = (
        jobs_of(f"huang2024-dynamic:law.z={z:g},law.frequency={f:g}", "cut-square", trial.seeds)
        for z, f in ((1.0, 2000.0), (5.0, 4000.0))
    )
    for name, text, unit in (("roughness", "roughness Rz", "µm"), ("dross", "dross", "mm"), ("taper", "taper u", "mm")):
        a, b = small[name], large[name]
        told = (estimate(a, unit), estimate(b, unit), text, small["through"].mean(), large["through"].mean())
        rows("focus-dither", told, holds=np.median(b - a) > 0)
    steel = materials.material("c45-10")
    strokes = np.linspace(0.0, 5.0, 26)
    lines = {}
    for kilohertz in (2.0, 4.0):
        dithers = [spot.Command(frequency=1e3 * kilohertz, x=0.3, y=0.3, z=float(z)) for z in strokes]
        figures = [fit_cut.streamed(steel.params, steel.power, {"feed": 1.0, "dither": d}) for d in dithers]
        lines[kilohertz] = np.array([(1e3 * f.roughness, f.dross) for f in figures])

    @illustrated("Huang2024 Fig. 8", 2)
    def focus_dither(*axes: Axes) -> None:
        """C45 of 10 mm at 1 m/min, ±0.3 mm in x and y, straight cut, streaming form. Calibrated at ±1 mm and 2 kHz
        only; the rest is what the model extrapolates."""
        for k, (ax, label) in enumerate(zip(axes, ("roughness Rz, µm", "dross, mm"), strict=True)):
            for colour, style, (kilohertz, values) in zip(COLOURS, ("-", "--"), lines.items(), strict=False):
                ax.plot(strokes, values[:, k], style, color=colour, label=f"{kilohertz:g} kHz")
            ax.set(xlabel="amplitude of the focus' dither, mm", ylabel=label)
        axes[0].legend(frameon=False)

    return [focus_dither()]


@study("huang2024", "The trajectory-parameter adjusting unit")
def adjusting_unit(trial: Trial, rows: Rows) -> list[Drawing]:
    """The rules of ``huang2024-adjusting`` beside the dynamic method on the whole cutting suite, seed by seed."""
    names, core = ("huang2024-dynamic", "huang2024-adjusting"), scenarios.core("cutting")
    tuned = len(preset(names[1])["parameters"])
    plain, adjusted = ([jobs_of(name, scenario, trial.seeds) for scenario in core] for name in names)
    for key, text, claim in (
        ("contour_rms", "RMS contour error", "more accurate"),
        ("contour_max", "largest contour error", "more accurate"),
        ("gap_rms", "RMS standoff error", "more accurate"),
        ("roughness", "roughness Rz", "better"),
        ("dross", "dross", "better"),
        ("time", "time of the job", "more efficient"),
        ("energy", "energy of the beam", "more efficient"),
    ):
        each = np.array([np.log(b[key] / a[key]) for a, b in zip(plain, adjusted, strict=True)])
        ratio = estimate(np.exp(each.mean(axis=0)), digits=4)
        fewer = ratio.high if np.isfinite(ratio.high) else ratio.value
        case = "unchanged" if rows and abs(ratio.value - 1) <= 0.005 else "" if rows else "first"
        rows("adjusting", (ratio, text, len(core), tuned), holds=fewer < 0.995, paper=claim, case=case)
    signals = stacks.get(names[1]).law.signals._fields
    fed = [name for name in ("speed", "lag", "contour_error", "height") if name in signals]
    missing = sorted({"pressure", "margin", "kerf", "power"} - set(signals))
    holds = {"speed", "lag", "contour_error"} <= set(fed)
    rows("signals-of-the-unit", (", ".join(fed), ", ".join(missing)), holds=holds)
    return [_adjusting()]


@illustrated("Huang2024 §4, Fig. 6", 2, height=3.8)
def _adjusting(feed: Axes, error: Axes) -> None:
    """The corner of cut-corners with the largest contour error (seed 1000): speed of the axes and contour error, left
    of the path positive, with and without the unit. It goes through more slowly."""
    corner = 0.0
    for name, colour, style in (("huang2024-dynamic", COLOURS[1], "--"), ("huang2024-adjusting", COLOURS[0], "-")):
        channels = _recorded(name, "cut-corners")
        c = {key: channels[:, i].astype(float) for i, key in enumerate(gantry.CHANNELS)}
        on = c["phase"] == gantry.CUT
        way = c["s"][on] - c["s"][on][0]
        corner = corner or float(way[np.argmax(np.abs(c["error"][on]) * (way > 10.0))])
        feed.plot(way, 0.06 * c["speed"][on], style, color=colour, lw=1.0, label=name)
        error.plot(way, 1e3 * c["error"][on], style, color=colour, lw=1.0)
    for ax in (feed, error):
        ax.set(xlabel="way along the cut, mm", xlim=(corner - 6, corner + 6))
    feed.set(ylabel="speed, m/min", ylim=(0, 1.35))
    error.set(ylabel="contour error, µm")
    feed.legend(frameon=False, loc="upper center", ncols=1, fontsize=8)
