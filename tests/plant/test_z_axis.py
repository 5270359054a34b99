"""Z axis: its linear behaviour against python-control and scipy, its limits, friction, backlash and quantisation."""

import control
import numpy as np
import pytest
from scipy import integrate, signal

from kerfgym.envs.engine.compiler import for_python
from kerfgym.envs.plant import z_axis
from kerfgym.envs.plant.machine import DT, SUBSTEPS
from kerfgym.envs.plant.z_axis import GRAVITY, Drive, Params

LINEAR = Params(
    speed=1e9, acceleration=1e12, jerk=1e18, dac=0.0, encoder=0.0, friction=0.0, backlash=0.0, low=-1e12, high=1e12
)
"""Nothing but the velocity loop, the dead time and the structural mode."""

POSITION, VELOCITY, ACCELERATION, PLAY, HEAD = range(5)


def _driven(p, commands, start, trace):
    s, d, i = z_axis.at_rest(start), Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0
    g = z_axis.gains(p, DT)
    for n in range(commands.size):
        d = z_axis.accept(p, d, commands[n])
        r = z_axis.pace(p, d)
        for k in range(SUBSTEPS):
            s, head = z_axis.step(p, g, r, s, (k + 1.0) / SUBSTEPS, DT)
            trace[0, i], trace[1, i], trace[2, i], trace[3, i], trace[4, i] = (
                s.position,
                s.velocity,
                s.acceleration,
                s.play,
                head,
            )
            i += 1


def _extremes(p, commands, start, most):
    s, d, g = z_axis.at_rest(start), Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), z_axis.gains(p, DT)
    for n in range(commands.size):
        d = z_axis.accept(p, d, commands[n])
        r = z_axis.pace(p, d)
        for k in range(SUBSTEPS):
            before, was = s.acceleration, s.resist
            s, _ = z_axis.step(p, g, r, s, (k + 1.0) / SUBSTEPS, DT)
            released = was - s.resist if p.bristle > 0.0 else 0.0
            most[0] = max(most[0], abs(s.velocity))
            most[1] = max(most[1], abs(s.acceleration))
            most[2] = max(most[2], abs(s.acceleration - released - before) / DT)
            most[3] = max(most[3], p.low - s.position, s.position - p.high)
            most[4] = max(most[4], s.play)
            most[5] = min(most[5], s.play)


driven, extremes = for_python(_driven), for_python(_extremes)


def response(p: Params, commands, start: float = 0.0) -> np.ndarray:
    """Position, velocity, acceleration, play and head at the end of each substep, shape (5, substeps)."""
    trace = np.empty((5, len(commands) * SUBSTEPS))
    driven(p, np.asarray(commands, float), start, trace)
    return trace


def head_over_command(p: Params) -> control.TransferFunction:
    """The module's docstring as a transfer function, without the dead time."""
    s = control.tf("s")
    loop = p.omega**2 / (s**2 + 2 * p.zeta * p.omega * s + p.omega**2)
    mode = p.omega_r**2 / (s**2 + 2 * p.zeta_r * p.omega_r * s + p.omega_r**2)
    return loop * ((1 - p.compliance) + p.compliance * mode) / s


def linear(hertz: float, zeta: float, resonance: float = 100.0, compliance: float = 0.1, dead_time: float = 1.0):
    omega, omega_r = 2 * np.pi * hertz, 2 * np.pi * resonance
    return LINEAR._replace(omega=omega, zeta=zeta, omega_r=omega_r, compliance=compliance, dead_time=dead_time)


AXES = {
    "50 Hz": linear(50.0, 0.6, 60.0),
    "80 Hz": linear(80.0, 0.8),
    "80 Hz, stiff": linear(80.0, 0.8, compliance=0.0),
    "120 Hz": linear(120.0, 1.0, 150.0),
    "200 Hz": linear(200.0, 0.7, 150.0),
    "dead time 2": linear(80.0, 0.8, dead_time=2.0),
    "dead time 1.5": linear(80.0, 0.8, dead_time=1.5),
    "dead time 2.3": linear(120.0, 0.8, dead_time=2.3),
    "dead time 0": linear(80.0, 0.8, dead_time=0.0),
    "dead time 4": linear(80.0, 0.8, dead_time=4.0),
    "dead time 5.6": linear(80.0, 0.8, dead_time=5.6),
    "all of the compliance": linear(80.0, 0.8, 90.0, compliance=1.0)._replace(zeta_r=0.2),
}


# -------------------------------------------------------------------------------------------------- linear behaviour


@pytest.mark.parametrize("axis", AXES)
def test_the_head_follows_a_step_as_the_continuous_axis_does(axis):
    p = AXES[axis]
    head = response(p, np.full(150, 10.0))[HEAD]
    at = DT * np.arange(1, head.size + 1) - 1e-3 * p.dead_time
    ahead = at > 0.0
    exact = np.zeros(head.size)
    grid = np.linspace(0.0, 0.16, 6401)
    exact[ahead] = np.interp(at[ahead], grid, 10.0 * control.step_response(head_over_command(p), grid).outputs)
    lag = 10.0 * 2.0 * p.zeta / p.omega  # mm that the head stays behind in the long run
    assert np.abs(head - exact).max() < 0.01 * lag


@pytest.mark.parametrize("axis", AXES)
def test_the_frequency_response_is_that_of_the_continuous_axis_within_a_percent(axis):
    p, periods = AXES[axis], 1000
    hertz = np.arange(1, 201)
    phases = np.random.default_rng(1).uniform(0.0, 2 * np.pi, hertz.size)
    t = np.arange(periods) / 1000.0
    commands = np.cos(2 * np.pi * hertz[:, None] * t + phases[:, None]).sum(axis=0)
    head = response(p, np.tile(commands, 4))[HEAD, -periods * SUBSTEPS :]
    measured = np.fft.fft(head)[hertz] / np.fft.fft(np.repeat(commands, SUBSTEPS))[hertz]
    # The command is held over each substep, so python-control's zero-order hold is exact; a sample is a substep's end.
    z = np.exp(2j * np.pi * hertz * DT)
    exact = control.sample_system(head_over_command(p), DT, "zoh")(z) * z ** -(p.dead_time * 1e-3 / DT) * z
    assert np.abs(measured / exact - 1.0).max() < 0.01


def test_in_the_long_run_the_head_lags_a_speed_by_the_loop_and_the_dead_time():
    for p in AXES.values():
        position = response(p, np.full(2000, 20.0))[POSITION]
        lag = 20.0 * 2000e-3 - position[-1]
        assert lag == pytest.approx(20.0 * (1e-3 * p.dead_time + 2.0 * p.zeta / p.omega), rel=0.01, abs=1e-6)


@pytest.mark.parametrize("dead_time", [0.0, 0.25, 0.5, 1.0, 1.3, 1.5, 2.0, 2.3, 2.7, 3.0, 3.6, 4.0, 4.4, 5.0, 5.9, 6.0])
def test_a_command_takes_effect_after_the_dead_time_to_the_substep(dead_time):
    velocity = response(LINEAR._replace(dead_time=dead_time), np.full(8, 1.0))[VELOCITY]
    assert np.flatnonzero(velocity)[0] == round(dead_time * SUBSTEPS)


def test_the_structural_mode_rings_at_its_frequency_and_damping():
    p = linear(200.0, 1.0, 90.0, compliance=1.0)
    trace = response(p, np.concatenate([np.full(30, 50.0), np.zeros(150)]))
    ringing = (trace[HEAD] - trace[POSITION])[60 * SUBSTEPS :]
    peaks = signal.find_peaks(ringing)[0]
    damped = p.omega_r * np.sqrt(1.0 - p.zeta_r**2)
    assert 2 * np.pi / (np.diff(peaks).mean() * DT) == pytest.approx(damped, rel=0.005)
    assert np.log(ringing[peaks[0]] / ringing[peaks[4]]) == pytest.approx(
        4 * 2 * np.pi * p.zeta_r / np.sqrt(1.0 - p.zeta_r**2), rel=0.02
    )


# ----------------------------------------------------------------------------------------------------------- limits


LIMITED = {
    "default": Params(),
    "slow drive": Params(jerk=1e6),
    "one g": Params(acceleration=9810.0, jerk=5e6),
    "stiff loop": Params(omega=2 * np.pi * 200.0, zeta=0.6, acceleration=19620.0),
    "soft loop": Params(omega=2 * np.pi * 50.0, zeta=1.0, acceleration=18000.0, dead_time=2.0),
    "200 mm/s": Params(speed=200.0, dead_time=2.0),
    "bristles": Params(bristle=0.002, stiction=1.6, stribeck=1.0),
}


def random_commands(p: Params, periods: int, seed: int) -> np.ndarray:
    """Commands held for 1 to 50 ms, half of them full speed, and runs into both ends of the travel."""
    rng = np.random.default_rng(seed)
    count = periods // 20
    level = rng.uniform(-1.0, 1.0, count)
    level = np.where(rng.random(count) < 0.5, np.sign(level), level)
    jumps = np.repeat(level, rng.integers(1, 51, count))
    across = int(1.5e3 * (p.high - p.low) / p.speed)
    ends = np.repeat([-1.0, 1.0, -1.0, 1.0], across)
    return p.speed * np.concatenate([jumps, ends])[: periods + ends.size]


@pytest.fixture(scope="module")
def driven_hard() -> dict[str, np.ndarray]:
    """Largest speed, acceleration, jerk, overrun of the travel and play of each axis in a million random periods."""
    found = {}
    for i, (name, p) in enumerate(LIMITED.items()):
        found[name] = np.array([0.0, 0.0, 0.0, -1e9, 0.0, 0.0])
        for start in (0.0, 100.0):
            extremes(p, random_commands(p, 90_000, i), start, found[name])
    return found


@pytest.mark.parametrize("axis", LIMITED)
def test_speed_acceleration_and_jerk_never_exceed_their_limits(driven_hard, axis):
    p, (speed, acceleration, jerk, *_) = LIMITED[axis], driven_hard[axis]
    assert 0.99 * p.speed < speed <= p.speed
    # Bristles that let go add what they held.
    assert acceleration <= p.acceleration + (p.stiction * p.friction if p.bristle else 0.0)
    assert jerk <= p.jerk * (1.0 + 1e-9)
    # The limits are reached: it is they that hold, not the commands.
    assert jerk > 0.99 * p.jerk
    assert acceleration > 0.6 * p.acceleration


@pytest.mark.parametrize("axis", LIMITED)
def test_the_axis_stays_inside_its_travel_to_a_count(driven_hard, axis):
    overrun = driven_hard[axis][3]
    assert overrun <= 1e-3
    assert overrun > -5.0  # it does come near the ends


@pytest.mark.parametrize("axis", LIMITED)
def test_the_head_never_leaves_the_backlash(driven_hard, axis):
    p, (*_, most, least) = LIMITED[axis], driven_hard[axis]
    assert least == 0.0
    assert most <= p.backlash


def test_a_command_beyond_the_top_speed_is_the_top_speed():
    p = Params(friction=0.0)
    assert np.array_equal(response(p, np.full(200, 5000.0), -30.0), response(p, np.full(200, 500.0), -30.0))
    assert response(p, np.full(180, 5000.0), -30.0)[VELOCITY, -1] > 0.97 * p.speed


# --------------------------------------------------------------------------------------------- backlash and friction


def test_gravity_keeps_the_backlash_closed_below_a_downward_g():
    p = Params(acceleration=9800.0, backlash=0.01)
    most = np.array([0.0, 0.0, 0.0, -1e9, 0.0, 0.0])
    extremes(p, random_commands(p, 50_000, 3), 30.0, most)
    assert most[1] > 9700.0
    assert most[4] == 0.0


def test_beyond_a_g_the_head_falls_freely_until_the_backlash_is_used_up():
    p = Params(acceleration=18000.0, jerk=1e9, backlash=0.05, compliance=0.0, friction=0.0)
    position, _, acceleration, play, head = response(p, np.concatenate([np.zeros(5), np.full(30, -400.0)]), 60.0)
    assert np.abs(head - position - play).max() < 1e-12
    open_ = np.argmax(play >= p.backlash)
    free = np.flatnonzero((play[:open_] > 1e-3) & (play[:open_] < 0.049))
    assert free.size > 20
    assert acceleration[free].max() < -GRAVITY
    t = DT * (free - free[0])
    assert 2.0 * np.polyfit(t, head[free], 2)[0] == pytest.approx(-GRAVITY, rel=1e-3)
    assert play.max() == pytest.approx(p.backlash)
    assert play[-1] == 0.0  # at constant speed gravity has closed it again


@pytest.mark.parametrize("command", [0.05, 2.0, 50.0, -300.0])
def test_against_friction_the_loop_still_reaches_the_commanded_speed(command):
    p = Params(dac=0.0, jerk=1e9)
    velocity = response(p, np.full(250, command), 20.0 if command > 0 else 100.0)[VELOCITY]
    assert velocity[-1] == pytest.approx(command, rel=1e-3)


def test_friction_acts_as_a_disturbance_that_the_loop_works_against():
    # The axis reverses; scipy integrates b' = ω²(u − v) − 2ζω(b − F), v' = b − F, F = friction within `creep` of rest.
    p = Params(dac=0.0, jerk=1e9, acceleration=1e6, friction=2000.0, dead_time=0.0)
    commands = np.repeat([20.0, -20.0], 60)
    velocity = response(p, commands, 30.0)[VELOCITY]

    def force(v):
        return np.clip(v * p.friction / p.creep, -p.friction, p.friction)

    def rates(t, y):
        u = 20.0 if t < 0.06 else -20.0
        v, b = y
        return [b - force(v), p.omega**2 * (u - v) - 2 * p.zeta * p.omega * (b - force(v))]

    at = DT * np.arange(1, velocity.size + 1)
    exact = integrate.solve_ivp(rates, (0.0, at[-1]), [0.0, 0.0], t_eval=at, max_step=2e-5, rtol=1e-9).y[0]
    assert np.abs(velocity - exact).max() < 0.01 * 20.0
    free = response(p._replace(friction=0.0), commands, 30.0)[VELOCITY]
    assert np.abs(free - exact).max() > 0.1 * 20.0


# --------------------------------------------------------------------------------------------------- LuGre's friction


LUGRE = Params(friction=800.0, bristle=0.005, stiction=1.5, stribeck=3.0, dac=0.0, encoder=0.0, dead_time=0.0)


def sliding(p: Params, v):
    """Friction of steady sliding, mm/s²: from static friction at rest down to Coulomb's (Hess and Soom 1990)."""
    return p.friction * (1.0 + (p.stiction - 1.0) / (1.0 + (v / p.stribeck) ** 2))


def dragged(p: Params, v: float, substeps: int, dt: float = DT) -> np.ndarray:
    """Friction while the motor is drawn along at the speed ``v``, mm/s², shape (substeps,)."""
    g, s, out = z_axis.gains(p, DT), z_axis.at_rest(0.0)._replace(velocity=v), np.empty(substeps)
    for i in range(substeps):
        s = s._replace(bent=z_axis.bend(p, g, s, dt))
        out[i] = g.spring * s.bent
    return out


def _rubbing(p, commands, start, trace):
    s, d, i = z_axis.at_rest(start), Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0
    g = z_axis.gains(p, DT)
    for n in range(commands.size):
        d = z_axis.accept(p, d, commands[n])
        r = z_axis.pace(p, d)
        for k in range(SUBSTEPS):
            s, _ = z_axis.step(p, g, r, s, (k + 1.0) / SUBSTEPS, DT)
            trace[0, i], trace[1, i], trace[2, i] = s.position, s.velocity, s.resist
            i += 1


rubbing = for_python(_rubbing)


def rubbed(p: Params, commands, start: float = 30.0) -> np.ndarray:
    """Position, velocity and friction at the end of each substep, shape (3, substeps)."""
    trace = np.empty((3, len(commands) * SUBSTEPS))
    rubbing(p, np.asarray(commands, float), start, trace)
    return trace


@pytest.mark.parametrize("v", [0.05, 0.5, 1.0, 3.0, 10.0, 100.0, 500.0, -0.5, -3.0, -500.0])
def test_in_steady_sliding_friction_falls_with_speed_from_static_to_coulomb(v):
    for p in (LUGRE, LUGRE._replace(friction=1000.0, bristle=0.002, stiction=1.2, stribeck=1.0)):
        way = 20 * p.bristle * p.stiction  # mm; a bristle's bend dies out over its own length
        friction = dragged(p, v, round(max(way / abs(v) / DT, 50.0)))
        assert friction[-1] == pytest.approx(np.sign(v) * sliding(p, v), rel=1e-6)


@pytest.mark.parametrize("command", [5.0, 60.0, -200.0])
def test_an_axis_that_slides_feels_that_friction(command):
    _, velocity, friction = rubbed(LUGRE, np.full(400, command), 10.0 if command > 0 else 100.0)
    assert velocity[-1] == pytest.approx(command, rel=1e-3)
    assert friction[-1] == pytest.approx(np.sign(command) * sliding(LUGRE, command), rel=1e-4)


def test_before_it_slides_friction_is_a_spring_that_gives_way_over_a_bristle():
    # Drawn along slowly, dF/dx = σ·(1 − F/F_s) with σ = Coulomb/bristle: F = F_s·(1 − exp(−σ·x/F_s)).
    p, v = LUGRE, 0.02
    friction = dragged(p, v, 60_000)
    x = v * DT * np.arange(1, 60_001)
    static, stiffness = sliding(p, v), p.friction / p.bristle
    assert np.abs(friction - static * (1.0 - np.exp(-stiffness * x / static))).max() < 1e-3 * static
    assert friction[24] / x[24] == pytest.approx(stiffness, rel=0.01)


def exactly_rubbed(p: Params, commands) -> np.ndarray:
    """Velocity at the end of each period by scipy, mm/s: the loop under held commands, with LuGre's equations."""
    stiffness = p.friction / p.bristle

    def rates(_, y, u):
        v, b, bent = y  # b: acceleration without friction
        a = b - stiffness * bent
        return [a, p.omega**2 * (u - v) - 2.0 * p.zeta * p.omega * a, v - stiffness * abs(v) * bent / sliding(p, v)]

    y, out = np.zeros(3), []
    for u in commands:
        y = integrate.solve_ivp(rates, (0.0, 1e-3), y, args=(u,), method="LSODA", rtol=1e-8, atol=1e-10).y[:, -1]
        out.append(y[0])
    return np.array(out)


SLOW = 0.5 * np.sin(2.0 * np.pi * 3.0 * 1e-3 * np.arange(700))
"""mm/s: two turns of a sine of 3 Hz, ±27 µm, in periods of 1 ms."""

STICKY = LUGRE._replace(friction=1000.0, bristle=0.002, stiction=1.6, stribeck=1.0, omega=314.0, zeta=0.6)


@pytest.mark.parametrize("p", [LUGRE, STICKY])
def test_a_slow_axis_sticks_and_breaks_loose_as_scipy_says(p):
    p = p._replace(jerk=1e9, acceleration=1e6)
    exact = exactly_rubbed(p, SLOW)
    velocity = rubbed(p, SLOW)[1, SUBSTEPS - 1 :: SUBSTEPS]
    free = rubbed(p._replace(friction=0.0), SLOW)[1, SUBSTEPS - 1 :: SUBSTEPS]
    assert np.abs(velocity - exact).max() < 0.02 * np.abs(exact).max()
    assert np.sqrt(np.mean((velocity - exact) ** 2)) < 0.01 * 0.5
    assert np.abs(free - exact).max() > 0.25 * 0.5


def test_a_drive_at_its_jerk_limit_feels_friction_as_scipy_says():
    # The limit holds the motor's push b, not the pull of the bristles: b' = clip(ω²(u − v) − 2ζω·a), a = b − σz.
    p, t = LUGRE._replace(jerk=1e6, acceleration=14000.0), 1e-3 * np.arange(400)
    stiffness, commands = p.friction / p.bristle, 20.0 * np.where(t % 0.2 < 0.1, 1.0, -1.0)

    def rates(_, y, u):
        v, b, bent = y
        a = b - stiffness * bent
        push = np.clip(p.omega**2 * (u - v) - 2.0 * p.zeta * p.omega * a, -p.jerk, p.jerk)
        return [a, push, v - stiffness * abs(v) * bent / sliding(p, v)]

    y, exact = np.zeros(3), []
    for u in commands:
        y = integrate.solve_ivp(rates, (0.0, 1e-3), y, args=(u,), max_step=2e-5, rtol=1e-8, atol=1e-10).y[:, -1]
        exact.append(y[0])
    velocity = rubbed(p, commands)[1, SUBSTEPS - 1 :: SUBSTEPS]
    assert np.abs(velocity - exact).max() < 0.05  # mm/s


def test_an_axis_sticks_where_it_turns_back():
    turning = slice(280, 420)  # around the second reversal, at 333 ms
    free, viscous, stuck = (
        np.sum(np.abs(rubbed(p, SLOW)[1, SUBSTEPS - 1 :: SUBSTEPS][turning]) < 0.05)
        for p in (STICKY._replace(friction=0.0), STICKY._replace(bristle=0.0), STICKY)
    )
    assert free < 15  # ms
    assert viscous < 15
    assert stuck > 40


@pytest.mark.parametrize("dt", [1e-6, DT, 1e-4, 1e-3, 1e-1])
@pytest.mark.parametrize("v", [1e-3, 1.0, 500.0, -500.0])
def test_no_step_bends_bristles_beyond_what_static_friction_bears(dt, v):
    for p in (LUGRE, LUGRE._replace(friction=1e4, bristle=z_axis.SHORTEST_BRISTLE, stiction=3.0, stribeck=0.1)):
        friction = dragged(p, v, 200, dt)
        assert np.abs(friction).max() <= sliding(p, 0.0) * (1 + 1e-9)
        assert np.all(np.diff(np.abs(friction)) >= -1e-9 * p.friction)
        assert abs(dragged(p, v, 200, 1e3)[-1]) == pytest.approx(sliding(p, v), rel=1e-6)


def test_friction_stays_bounded_while_the_axis_is_driven_hard():
    p = LUGRE._replace(bristle=0.002, stiction=1.6, stribeck=1.0)
    _, velocity, friction = rubbed(p, random_commands(p, 20_000, 7))
    assert np.abs(velocity).max() > 0.99 * p.speed
    assert 1.1 * p.friction < np.abs(friction).max() <= sliding(p, 0.0) * (1 + 1e-9)


@pytest.mark.parametrize("friction", [100.0, 1000.0, 10_000.0])
@pytest.mark.parametrize("hertz", [5.0, 50.0, 120.0, 500.0])
@pytest.mark.parametrize("bristle", [z_axis.SHORTEST_BRISTLE, 5e-4, 0.01])
def test_an_axis_that_is_told_to_stop_comes_to_rest(friction, hertz, bristle):
    p = Params(omega=2 * np.pi * hertz, zeta=0.2, friction=friction, bristle=bristle, stiction=3.0, stribeck=0.1)
    velocity = rubbed(p, np.concatenate([np.full(300, 200.0), np.zeros(3000)]))[1]
    assert np.abs(velocity).max() > 100.0
    assert np.abs(velocity[-2000:]).max() < 1e-3


def test_an_axis_without_friction_has_nothing_to_bend():
    commands = random_commands(LIMITED["default"], 500, 8)
    free = Params(friction=0.0)
    assert np.array_equal(rubbed(free._replace(bristle=0.005, stiction=2.0), commands), rubbed(free, commands))


def test_a_command_acts_after_its_dead_time_however_long():
    p = Params(dac=0.0)
    for dead_time in (0.0, 0.3, 5.0, 5.9, 6.0, 6.4, 7.0, 10.5, 11.0, 14.2, 15.0, 18.9, 19.0, 21.3, 22.0):
        drive, late, course = Drive(), z_axis.Late(), []
        for n in range(40):
            late = z_axis.passed_on(late, drive.c6)
            drive = z_axis.accept(p, drive, float(n + 1))
            pace = z_axis.late_pace(p._replace(dead_time=dead_time), drive, late)
            course += [pace.before if (k + 1) / 20 <= pace.change else pace.after for k in range(20)]
            if dead_time <= 6.0:
                assert pace == z_axis.pace(p._replace(dead_time=dead_time), drive)._replace(before=pace.before)
        first = round(20 * dead_time)
        assert course[:first] == [0.0] * first
        assert course[first:] == [1.0 + k // 20 for k in range(len(course) - first)]


# ------------------------------------------------------------------------------------------------------ quantisation


def test_the_drive_gets_whole_steps_of_a_16_bit_converter():
    p = Params()
    step = 500.0 / 2**15
    for command in np.random.default_rng(5).uniform(-500.0, 500.0, 200):
        sent = z_axis.accept(p, Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), command).c0
        assert abs(sent - command) <= 0.5 * step + 1e-12
        assert sent / step == pytest.approx(round(sent / step), abs=1e-9)
    queue = Drive(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
    assert z_axis.accept(p, queue, 0.4 * step) == Drive(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert z_axis.accept(p, Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 9e9).c0 == 500.0
    assert z_axis.accept(p, Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), -9e9).c0 == -500.0
    assert z_axis.accept(p._replace(dac=0.0), Drive(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.123456).c0 == 0.123456


def test_the_encoder_reads_whole_micrometres():
    p = Params()
    for position in np.random.default_rng(6).uniform(-40.0, 110.0, 200):
        read = z_axis.encoded(p, position)
        assert abs(read - position) <= 0.5e-3 + 1e-12
        assert read * 1e3 == pytest.approx(round(read * 1e3), abs=1e-6)
        assert z_axis.encoded(p._replace(encoder=0.0), position) == position


def test_an_axis_at_rest_stays_at_rest():
    trace = response(Params(), np.zeros(200), 12.345)
    assert np.all(trace[POSITION] == 12.345)
    assert np.all(trace[HEAD] == 12.345)
    assert not trace[1:4].any()
