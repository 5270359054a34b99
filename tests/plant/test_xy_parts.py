"""Parts of cut, spot, published ranges and axes in plain Python against the oracle's equations, at random settings.

What :mod:`test_xy_oracle` compares along whole jobs is compared here far from any job, and without the compiler.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from kerfgym.envs.plant import cut, published, spot, xy_axes
from kerfgym.envs.plant.controller import Process
from kerfgym.tests.oracle.xy_machine import PERIOD, XYMachine, axis

N, STEPS = 24, 24


def columns(cls: Any, rng: np.random.Generator, **ranges: tuple[float, float]) -> tuple[list[Any], SimpleNamespace]:
    """Params of N machines, default but for what is drawn; as a list, and as arrays."""
    drawn = {name: rng.uniform(*limits, N) for name, limits in ranges.items()}
    each = [cls()._replace(**{name: float(v[i]) for name, v in drawn.items()}) for i in range(N)]
    return each, SimpleNamespace(**{name: np.array([float(getattr(p, name)) for p in each]) for name in cls._fields})


def machine(**parts: Any) -> XYMachine:
    """An oracle without a job."""
    oracle = object.__new__(XYMachine)
    oracle.n = N
    for name, value in parts.items():
        setattr(oracle, name, value)
    return oracle


def test_the_cut_is_what_its_equations_say():
    rng = np.random.default_rng(1)
    each, c = columns(
        cut.Params,
        rng,
        thickness=(1.0, 15.0),
        focus=(-1.0, 5.0),
        w0=(0.05, 0.2),
        pressure=(0.3, 1.5),
        upturn_from=(0.3, 2.0),
        floor=(0.0, 0.02),
        slot=(0.05, 0.5),
        film=(1e-6, 4e-5),
        gas_above=(0.5, 2.0),
        carry=(0.0, 1.0),
    )
    zeros = {name: np.zeros(N) for name in ("base", "high", "low", "way", "lengths", "geometric", "error2", "weight")}
    oracle, states, open_kerf = machine(c=c, **zeros), [cut.fresh()] * N, 0
    for _ in range(STEPS):
        power, along, across, up = (rng.uniform(0.0, most, N) for most in (6000.0, 0.3, 0.3, 2.0))
        power *= 10.0 ** rng.choice([0.0, 0.0, 0.0, -2.7, -2.4, -2.1, -1.8, -1.5], N)  # many hardly melt
        focus, error, contour = (rng.uniform(-most, most, N) for most in (1.5, 1.0, 0.05))
        frequency = rng.choice([0.0, 50.0, 800.0, 3000.0], N)
        speed = rng.uniform(0.0, 250.0, N) * rng.choice([0.0, 0.05, 1.0], N)
        oracle.realised = {"frequency": frequency, "focus": focus}
        wanted = oracle._quality(power, along, across, up, speed, error, contour)
        for i, p in enumerate(each):
            numbers = (q[i] for q in (power, along, across, up, focus, frequency))
            states[i], found = cut.step(p, cut.beam(p, *numbers), states[i], speed[i], error[i], contour[i], PERIOD)
            assert found._asdict() == pytest.approx({n: v[i] for n, v in wanted.items()}, rel=1e-6, abs=1e-9)
            assert states[i]._asdict() == pytest.approx({n: getattr(oracle, n)[i] for n in zeros}, rel=1e-6, abs=1e-9)
        # How often the film would close the kerf's lower edge.
        open_kerf += (wanted["dross"] > 3.0).sum()
    assert open_kerf > 0


def test_spot_and_published_settings_are_what_their_equations_say():
    rng = np.random.default_rng(2)
    optics, o = columns(
        spot.Params,
        rng,
        galvo=(500.0, 6000.0),
        galvo_zeta=(0.3, 1.2),
        galvo_range=(0.1, 0.4),
        piezo=(500.0, 9000.0),
        piezo_zeta=(0.3, 1.2),
        piezo_range=(0.5, 5.0),
        hysteresis=(0.0, 0.2),
        highest=(500.0, 4000.0),
    )
    ranges, r = columns(
        published.Range,
        rng,
        feed_low=(2.0, 10.0),
        feed_static=(15.0, 20.0),
        feed_high=(20.0, 30.0),
        power_low=(0.5, 0.9),
        power_high=(1.0, 1.1),
        frequency_low=(200.0, 900.0),
        frequency_high=(1000.0, 3000.0),
        amplitude=(0.1, 0.3),
        deep_low=(0.1, 1.0),
        deep_high=(0.5, 3.0),
        focus=(0.0, 0.5),
        standoff=(0.0, 0.3),
    )
    r.bounded = rng.choice([0.0, 1.0], N)
    recipe = SimpleNamespace(most_override=2.0, most_power=1.2, most_standoff=1.0)
    oracle = machine(optics=o, range=r, recipe=recipe, journey=SimpleNamespace(feed=np.full(N, 18.0)))
    oracle.due_process = np.ones(N, bool)
    oracle.applied, oracle.realised = {}, {n: np.zeros(N) for n in spot.Realised._fields}
    oracle.applied = {n: np.zeros(N) for n in Process._fields}
    low = Process(-0.5, -0.5, -500.0, -0.1, -0.1, -1.0, -7.0, -2.0)
    high = Process(3.0, 1.5, 5000.0, 0.5, 0.5, 7.0, 7.0, 2.0)
    for _ in range(STEPS):
        before = oracle.realised["focus"].copy()
        oracle.wish = {n: rng.uniform(getattr(low, n), getattr(high, n), N) for n in Process._fields}
        oracle.wish["frequency"] *= rng.choice([0.0, 1.0], N)
        wish = oracle.wish
        oracle._apply()
        for i in range(N):
            w, p = Process(*(float(wish[n][i]) for n in Process._fields)), optics[i]
            c = Process(
                min(max(w.override, 0.05), 2.0),
                min(max(w.power, 0.0), 1.2),
                min(max(w.frequency, 0.0), p.highest),
                *(
                    min(max(v, 0.0), most)
                    for v, most in ((w.x, p.galvo_range), (w.y, p.galvo_range), (w.z, p.piezo_range))
                ),
                min(max(w.focus, -p.piezo_range), p.piezo_range),
                min(max(w.standoff, -1.0), 1.0),
            )
            if r.bounded[i]:
                c = published.bounded(ranges[i], 18.0, c)
            assert c._asdict() == pytest.approx({n: v[i] for n, v in oracle.applied.items()}, rel=1e-9, abs=1e-12)
            real = spot.realised(p, spot.Command(c.frequency, c.x, c.y, c.z, c.focus), before[i])
            assert real._asdict() == pytest.approx({n: v[i] for n, v in oracle.realised.items()}, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("beyond", [1.5, 4.0])
def test_the_optics_give_no_more_than_their_ranges_whatever_is_asked(beyond):
    p = spot.Params()
    most = spot.Command(p.highest, p.galvo_range, p.galvo_range, p.piezo_range, p.piezo_range)
    for name in most._fields:
        asked = most._replace(**{name: beyond * getattr(most, name)})
        assert spot.realised(p, asked, 0.0) == spot.realised(p, most, 0.0)
        opposite = most._replace(**{name: -beyond * getattr(most, name)})
        least = -p.piezo_range if name == "focus" else 0.0
        assert spot.realised(p, opposite, 0.0) == spot.realised(p, most._replace(**{name: least}), 0.0)


def test_an_axis_does_what_its_equations_say():
    rng = np.random.default_rng(3)
    each, p = columns(
        xy_axes.Params,
        rng,
        t1=(0.012, 0.03),
        t2=(0.002, 0.01),
        tau=(0.0, 0.004),
        gain=(0.5, 1.5),
        acceleration=(500.0, 6000.0),
        speed=(50.0, 200.0),
    )
    p.literal = np.zeros(N)
    p.dac = rng.choice([0.0, 0.5], N)
    drive, c1 = np.zeros((N, 4, 4)), (p.t1 - p.tau) / (p.t1 - p.t2)
    for i in range(N):
        rates = np.zeros((4, 4))
        rates[0, [0, 3]] = [-1.0 / p.t1[i], c1[i] / p.t1[i]]
        rates[1, [1, 3]] = [-1.0 / p.t2[i], (1.0 - c1[i]) / p.t2[i]]
        rates[2, :2] = 1.0
        drive[i] = expm(PERIOD * rates)
    oracle, a, due = machine(p=p, drive=drive), axis(np.zeros(N)), np.ones(N, bool)
    oracle.due = due
    slides = [xy_axes.at_rest(0.0)] * N
    each = [q._replace(dac=float(p.dac[i])) for i, q in enumerate(each)]
    plus, minus = rng.uniform(0.8, 1.2, (2, N))
    for _ in range(4 * STEPS):
        command = rng.uniform(-250.0, 250.0, N)
        oracle._take(a, command, plus, minus)
        oracle._move(a)
        for i, q in enumerate(each):
            told = xy_axes.commanded(q, slides[i], command[i], plus[i], minus[i])
            slides[i] = xy_axes.moved(q, xy_axes.gains(q, PERIOD), told, PERIOD)
        found = np.array([(s.position, xy_axes.velocity(s), s.command) for s in slides]).T
        assert found == pytest.approx(np.array([a.position, a.parts.sum(axis=0), a.command]), rel=1e-9, abs=1e-9)
