"""Measured data in place of the model's: height map, calibration table, recorded signal."""

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import get, team
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import calibration, heads
from kerfgym.envs.scenarios import Scenario
from kerfgym.envs.tasks import workshop
from kerfgym.experiments.measure.rollout import fleet_for, roll

QUIET = {"noise": 0.0, "jitter": 0.0, "impulses": 0.0, "nominal": True}


def written(path, header, rows):
    path.write_text("\n".join([header, *(",".join(f"{x:.9g}" for x in row) for row in rows)]), encoding="utf-8")
    return str(path)


def surface(x, y):
    return 0.4 * np.sin(x / 15.0) + 0.02 * y


@pytest.fixture
def chart(tmp_path):
    x, y = np.meshgrid(np.arange(-5.0, 61.0), np.arange(-5.0, 61.0))
    rows = np.stack([x.ravel(), y.ravel(), surface(x, y).ravel()], axis=1)
    return written(tmp_path / "map.csv", "x_mm,y_mm,height_mm", np.random.default_rng(0).permutation(rows))


def test_a_height_map_lies_under_the_actual_axes(chart):
    scenario = Scenario(
        name="m",
        job={"part": "circle", "size": 40.0, "material": "mild-steel"},
        sheet={"map": {"file": chart}},
        head=QUIET,
    )
    fleet = workshop.fleet_for(scenario, team("wu"), [1000])
    z, g = fleet.start_recording(3000), fleet.gantries.start_recording(3000, fleet.tick)
    fleet.advance(3000)
    x, y = (g[:, i, 0].astype(float) for i in (0, 1))
    assert np.ptp(x) > 20.0
    assert np.allclose(z[:, 3, 0], surface(x, y), atol=1.5e-3)  # bilinear between points 1 mm apart: h²/8·|f''|


def test_beyond_the_maps_border_the_border_goes_on(chart):
    scenario = Scenario(name="m", duration=0.6, sheet={"map": {"file": chart}}, head=QUIET)
    record = roll(scenario, get("observer"), [1000])
    assert record["surface"][-1, 0] == pytest.approx(surface(60.0, 0.0), abs=1e-5)  # at 120 mm


def test_a_table_of_ones_own_is_what_heights_are_looked_up_in(tmp_path):
    own = heads.table(0)
    file = tmp_path / "table.csv"
    shifted = calibration.Table(own.frequency, own.height + 0.1, *own[2:])
    calibration.write_csv(shifted, file)
    flat = {"name": "flat", "duration": 0.8, "axis": {"dead_time": 0.001}}
    plain, moved = (
        roll(Scenario(**flat, head={**QUIET, **more}), get("observer"), [1000]) for more in ({}, {"table": str(file)})
    )
    # What reads 0.1 mm too high is held 0.1 mm too low.
    assert np.mean(moved["gap"][-100:, 0] - plain["gap"][-100:, 0]) == pytest.approx(-0.1, abs=2e-3)


def test_a_recorded_signal_is_what_the_filter_gets(tmp_path):
    own = heads.table(0)
    heights = 0.8 + 0.05 * np.sin(np.arange(400) / 20.0)
    recorded = np.interp(heights, own.height, own.frequency)
    file = written(tmp_path / "signal.csv", "time_ms,frequency_Hz", np.stack([np.arange(400), recorded], axis=1))
    scenario = Scenario(name="r", duration=0.3, head={**QUIET, "signal": file}, set_height=0.8)
    fleet = fleet_for(scenario, get("idle"), [1000])
    record = fleet.start_recording(300)
    fleet.advance(300)
    assert np.allclose(record[:, 2, 0], heights[1:301], atol=1e-3)  # the first reading is that of the reset
    other = fleet_for(Scenario(name="s", head=QUIET), get("idle"), [1000])  # the next one listens to its sensor again
    other.advance(1)
    assert abs(other.get("signals").raw_height - other.get("signals").gap) < 0.02


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("map", "x_mm,y_mm\n0,0\n", r"map\.csv, row 1: column height_mm is missing"),
        ("map", "x_mm,y_mm,height_mm\n0,0,0\n1,0,0\n0,1,0\n", r"3 points at 2 places along x and 2 along y are no"),
        ("map", "x_mm,y_mm,height_mm\n0,0,0\n1,0,0\n0,2,0\n1,2,0\n", r"the grid's spacing is not 1 mm throughout"),
        ("map", "x_mm,y_mm,height_mm\n0,0,0\n1,0,0\n0,1,x\n1,1,0\n", r"row 4, column height_mm: 'x' is not a number"),
        ("map", "x_mm,y_mm,height_mm\n0,0,0\n0,0,0\n1,1,0\n1,0,0\n", r"row 3: this point is there twice"),
        ("signal", "frequency_Hz\n3e6\n-1\n", r"row 3, column frequency_Hz: -1 Hz; it must be above 0"),
        ("signal", "f\n3e6\n", r"column frequency_Hz is missing"),
        (
            "table",
            "frequency_Hz,height_mm\n3e6,1\n2e6,2\n",
            r"row 3, column frequency_Hz: 2000000 after 3000000; freq.* must both rise",
        ),
    ],
)
def test_bad_data_is_named_when_the_scenario_is_read(tmp_path, name, text, message):
    (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
    table = '[sheet.map]\nfile = "map.csv"' if name == "map" else f'[head]\n{name} = "{name}.csv"'
    (tmp_path / "s.toml").write_text(f'name = "s"\n{table}\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match=message):
        scenarios.read(tmp_path / "s.toml")
