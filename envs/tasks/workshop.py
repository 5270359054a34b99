"""The workshop: from a scenario and a team of controllers to machines that are ready to follow a sheet or cut a job.

A job's programme depends on both: the scenario says what is cut, the stack in the slot ``xy`` how the path is planned
for the axes, the stack in the slot ``process`` how fast it is cut.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import scenarios
from ..control.stack import Stack, Team
from ..engine.quantity import InvalidInput
from ..figures import evidence
from ..paths import kerf, parts
from ..paths.checks import check_travel
from ..paths.drawing import Drawing
from ..paths.job import PlannedJob, Settings, driven
from ..paths.route import Cutting, Route, routed
from ..pictures.film import Film
from ..pictures.kerf_film import KerfFilm
from ..plant import heads, spot
from ..plant.fleet import Fleet
from ..plant.gantry import Recipe
from ..scenarios import Scenario
from ..scenarios.material import Material, material
from ..scenarios.travel import PLAIN


@functools.lru_cache(maxsize=32)
def drawing_of(job: scenarios.Job, travel: tuple[float, float], reading: scenarios.Reading = PLAIN) -> Drawing:
    """The drawing that a scenario's job cuts, moved so that it begins at x = y = 0, kerf compensated.

    Raises:
        InvalidInput: neither a built-in part nor a file that can be read, too large, or what the reader finds.
    """
    if job.part in parts.PARTS:
        sizes = {next(iter(parts.sizes(job.part))): job.size} if job.size else {}
        drawing = parts.part(job.part, **sizes)
    elif Path(job.part).suffix:
        drawing = scenarios.read_drawing(job.part, reading)
    else:
        drawing = parts.part(job.part)  # an error that names the nearest
    drawing = kerf.compensated(drawing, job.kerf)
    check_travel(drawing, travel)
    corner = np.concatenate(drawing.pieces).min(axis=0)
    origin = (drawing.origin[0] + float(corner[0]), drawing.origin[1] + float(corner[1]))
    return replace(drawing, pieces=[piece - corner for piece in drawing.pieces], origin=origin)


def route_of(scenario: Scenario) -> Route:
    """The route through the part of a scenario's job, whoever drives it; the same object for the same question.

    Raises:
        InvalidInput: the scenario has no job, or what :func:`drawing_of` finds.
    """
    try:
        return _route(_job(scenario), (scenario.gantry.travel_x, scenario.gantry.travel_y), scenario.drawing)
    except InvalidInput as error:
        raise InvalidInput(f"scenario '{scenario.name}': {error}") from None


@functools.lru_cache(maxsize=32)
def _route(job: scenarios.Job, travel: tuple[float, float], reading: scenarios.Reading) -> Route:
    cutting = Cutting(job.lead_in, job.kerf or _material(job).kerf, job.joints, job.joint_spacing, job.joint_width)
    return routed(drawing_of(job, travel, reading), cutting)


def material_of(scenario: Scenario) -> Material:
    """The material of a scenario's job."""
    return _material(_job(scenario))


def _material(job: scenarios.Job) -> Material:
    return material(job.material, job.thickness or None)


def programme(scenario: Scenario, team: Team) -> PlannedJob:
    """The job that the team makes of the scenario; the same object for the same question.

    Raises:
        InvalidInput: the scenario has no job, the feed is out of range, or what the drawing's reader finds.
    """
    axes, feed = team.xy.part("plan"), team.process.part("plan").feed
    _check_dither(scenario, team.process)
    return _programme(scenario.name, _job(scenario), scenario.drawing, scenario.gantry, tuple(axes), float(feed))


@functools.lru_cache(maxsize=32)
def _programme(
    name: str, job: scenarios.Job, reading: scenarios.Reading, gantry: scenarios.Gantry, axes: tuple, feed: float
) -> PlannedJob:
    from ..plant.planning import Axes

    plan_of, steel, limits = Axes(*axes), _material(job), scenarios.axes_of(gantry)
    settings = Settings(
        feed=feed or job.feed or steel.feed,
        rapid=limits.speed,
        speed=limits.speed,
        acceleration=plan_of.acceleration,
        jerk=plan_of.jerk,
        jump=plan_of.corner_jump,
        corners=plan_of.corners > 0.5,
        as_programmed=not (feed or job.feed),
        pierce=steel.pierce if job.pierce else (),
        standoff=steel.standoff,
        clearance=job.clearance,
        frog_leap=job.frog_leap,
        most_speed=limits.speed,
        most_acceleration=limits.acceleration,
    )
    if plan_of.acceleration > limits.acceleration:
        raise InvalidInput(
            f"plan.acceleration = {plan_of.acceleration:g} mm/s² is beyond the axes' {limits.acceleration:g} mm/s²"
        )
    try:
        return driven(_route(job, (gantry.travel_x, gantry.travel_y), reading), settings)
    except InvalidInput as error:
        raise InvalidInput(f"scenario '{name}': {error}") from None


def equip(fleet: Fleet, scenario: Scenario, team: Team, machines: Any) -> PlannedJob:
    """Writes job, recipe and material into the columns of ``machines``, whose fleet has gantries."""
    assert fleet.gantries
    g, steel, job = fleet.gantries, material_of(scenario), programme(scenario, team)
    wanted = _job(scenario)
    g.put_job(job, machines)
    nominal = {"power": steel.power, "standoff": steel.standoff, "thickness": steel.thickness}
    g.put("recipe", machines, Recipe(most_override=wanted.override, most_power=wanted.power, **nominal))
    g.put("cut", machines, steel.params)
    g.put("published", machines, evidence.published(steel.name, wanted.extrapolate))
    g.put("calibrated", machines, evidence.calibrated(steel.name))
    return job


def prepare(fleet: Fleet, scenario: Scenario, team: Team, machines: Any, seeds: Any, again: bool = False) -> None:
    """Writes a scenario, with its job if it has one, into the columns of ``machines``, one seed each.

    ``again``: they have been prepared for this very scenario before.
    """
    if len(team.stacks) == 1:
        scenarios.prepare(fleet, scenario, machines, seeds, again)
        return
    job = equip(fleet, scenario, team, machines)
    scenarios.prepare(fleet, scenario, machines, seeds)
    height = material_of(scenario).standoff + job.lift[0]
    fleet.set("start.gap", machines, height)
    fleet.set("job.set_height", machines, height)


def empty_fleet(size: int, team: Team, threads: int = 1) -> Fleet:
    """Machines that run the team's laws, with axes and a cut if it drives them."""
    fleet = Fleet(size, team.z.law, heads.POOL, threads)
    if len(team.stacks) > 1:
        fleet.use_gantries(team.xy.law, team.process.law)
    return fleet


def fleet_for(
    scenario: Scenario, team: Team, seeds: Any, threads: int = 1, change: Callable[[Fleet], None] | None = None
) -> Fleet:
    """A fleet with one machine per seed that has begun the scenario under ``team``; ``change`` is made before."""
    seeds = np.atleast_1d(np.asarray(seeds, np.uint64))
    fleet, every = empty_fleet(len(seeds), team, threads), np.arange(len(seeds))
    prepare(fleet, scenario, team, every, seeds)
    team.install(fleet, every)
    if change:
        change(fleet)
    fleet.begin(every, scenarios.noise_keys(seeds))
    return fleet


def film_of(scenario: Scenario, team: Team, seed: int, colour: str = "standoff") -> Film | KerfFilm:
    """What shows an episode that has just begun; the kerf of a job is coloured by ``colour``."""
    if scenario.job is None:
        return Film(scenario, team.name, seed)
    return KerfFilm(programme(scenario, team), f"{scenario.name} · {team.name} · seed {seed}", colour)


def _check_dither(scenario: Scenario, stack: Stack) -> None:
    """Settings that the scenario's optics cannot do would be limited without a word; they are an error."""
    law, optics = stack.part("law"), scenario.optics
    if {"frequency", "x", "y", "z", "focus"} <= set(law._fields):
        able = spot.Params(galvo_range=optics.galvo_range, piezo_range=optics.piezo_range, highest=optics.highest)
        try:
            spot.check(able, spot.Command(law.frequency, law.x, law.y, law.z, law.focus))
        except InvalidInput as error:
            raise InvalidInput(f"scenario '{scenario.name}', controller '{stack.name}': {error}") from None


def _job(scenario: Scenario) -> scenarios.Job:
    if scenario.job is None:
        raise InvalidInput(f"scenario '{scenario.name}' has no job; it needs a table [job]")
    return scenario.job
