"""Forecast"""
from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.baselines import drive_bank, self_tuning, trends
from kerfgym.envs.engine.lanes import clip, extended, logarithm, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

TRENDS = trends.TRENDS
BENT = (
    (21.51, 5.453, -58.7, -15.19, -1.26, -3.52, -5.472, -0.3278, 1.803, -0.5958, -0.1694, 0.5518),
    (0.9041, 1.81, 7.067, -0.7332, -0.3162, -0.6349, 0.1021, -0.08401, 0.9464, 0.4444, 0.0127, -0.2186),
    (1.923, 0.6232, -5.882, -1.295, -0.06957, -0.8918, -0.6807, -0.06165, 0.1162, -0.1173, -0.02396, 0.09972),
    (-0.6396, 0.2925, 2.032, 0.8899, -0.05146, -0.7718, -0.1482, -0.02345, 0.1983, 0.07191, -0.009952, -0.01368),
)

NF, NA = 3 + 3 * TRENDS + 3, 1 + 3 * TRENDS + 3
FF = 0
AT = FF + 32  # signals mm
RULE = AT + 32
ACTION = RULE + 80
OWN = ACTION + 80
BANK = OWN + 16
TREND = BANK + drive_bank.MEMORY
PREDICT = TREND + trends.MEMORY
MEMORY = PREDICT + self_tuning.MEMORY


class Own(NamedTuple):
    """own"""
    calm: Annotated[float, Quantity("1/s", 5.0, 120.0, "gain on a straight sheet", log=True)] = 60.0
    bow: Annotated[float, Quantity("1/s", 5.0, 120.0, "gain on a bent sheet", log=True)] = 100.0
    wait: Annotated[float, Quantity("ms", 10.0, 500.0, "before line counts", log=True)] = 100.0
    leave: Annotated[float, Quantity("1", 2.0, 12.0, "sigmas at which the line is left", log=True)] = 4.5
    ahead: Annotated[float, Quantity("ms", 0.0, 500.0, "lead of bent")] = 300.0
    edge: Annotated[float, Quantity("1", 0.1, 2.0, "ratio")] = 0.4
    smith2: Annotated[float, Quantity("1", 0.0, 1.0, "smith on a bent sheet")] = 0.7
    slead: Annotated[float, Quantity("mm/s²", 0.0, 2000.0, "friction")] = 600.0


Params = extended("Params", self_tuning.Params, Own, kp=105.92, ki=0.0, feed=0.83, lead=-1.3658, sharpen=1.0099, memory=225.07,
    prior=0.37823, gate=8.4708, jump=0.022991, rare=11.943, hold=4, recall=71.937, reach=1.6635, smith=0.70529, lag=5.4818, trust=17.986)
State = self_tuning.State


@part
def init(params):
    return self_tuning.init(params)


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    p, x, m = params, signals, memory
    t, q = m[TREND:PREDICT], m[PREDICT:MEMORY]
    s, o = self_tuning.outlook(p, state, x, q)
    seen = x.head_position - x.raw_height
    trends.update(t, x.fresh, s.known, o.measured, seen, x.feed, p.leave)
    bank = m[BANK:TREND]
    drive_bank.update(bank, x.fresh, x.head_position, x.command, p.slead)
    behind = bank[drive_bank.DEAD_TIME] + bank[drive_bank.LAG]
    moving = self_tuning._under_way(q, s.tick, behind)
    ahead = behind - self_tuning.MIDDLE
    coming = o.coming
    rise = 0.0
    if o.ready:
        speed = o.slope + o.bend * (ahead + p.lead + p.sharpen)
        coming = o.trusted * clip(speed, -o.most, o.most) / PERIOD
        rise = o.middle + o.slope * ahead + 0.5 * o.bend * ahead * ahead
    way = max(x.feed, trends.SLOWEST) * 1e-3
    straight = trends.straight(t, p.wait)
    ratio = trends.shaken(t)
    bent = clip((p.edge - ratio) / 0.1 , 0.0, 1.0) * (1.0 - straight) * clip((t[trends.AGE] - 20.0) / 20.0, 0.0, 1.0)
    a0, a1 = 0.0, 0.0
    later = behind - 5.5
    for k in range(TRENDS):
        z0 = t[trends.LEVEL + k] - o.measured
        z1 = t[trends.SLOPE + k] * trends.LENGTHS[k]
        z2 = t[trends.BEND + k] * trends.LENGTHS[k] * trends.LENGTHS[k]
        a0 += (BENT[0][3 * k] + later * BENT[2][3 * k]) * z0 + (BENT[0][3 * k + 1] + later * BENT[2][3 * k + 1]) * z1 + (BENT[0][3 * k + 2] + later * BENT[2][3 * k + 2]) * z2
        a1 += (BENT[1][3 * k] + later * BENT[3][3 * k]) * z0 + (BENT[1][3 * k + 1] + later * BENT[3][3 * k + 1]) * z1 + (BENT[1][3 * k + 2] + later * BENT[3][3 * k + 2]) * z2
    shaken = 1.0 - straight - bent
    at = bent * a0 * 100.0 / p.bow + straight * (t[trends.LINE] - o.measured + p.smith * t[trends.TILT] * way * behind) + shaken * p.smith * rise
    ff = bent * a1 * min(x.feed, p.ahead) + straight * t[trends.TILT] * way / PERIOD + shaken * p.feed * coming
    gain = shaken * p.kp + bent * p.bow + straight * p.calm
    smith = (1.0 - bent) * p.smith + bent * p.smith2
    m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7] = straight, bent, ratio, 1e3 * at, ff, behind, coming, s.known
    error = x.head_position - o.measured - at - x.set_height + smith * moving
    grown = s.integral + p.ki * PERIOD * clip(error, -self_tuning.LITTLE, self_tuning.LITTLE)
    integral = grown if o.ready and not x.override else 0.0
    return s._replace(integral=integral), ff - gain * error - integral
