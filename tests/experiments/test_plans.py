"""Plans of jobs: the picture before the run, the options of how a part is cut, and what a run's report shows of it."""

import functools
import io

import ezdxf
import numpy as np
import pandas as pd
import pytest
import tyro
from PIL import Image

from kerfgym.envs import scenarios
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.parts import part
from kerfgym.envs.paths.route import Cutting, routed
from kerfgym.envs.tasks import workshop
from kerfgym.experiments import cli
from kerfgym.experiments.benchmark import benchmarking
from kerfgym.experiments.measure import grids
from kerfgym.experiments.plots.png import png
from kerfgym.experiments.render import plan_picture, plans
from kerfgym.experiments.results import archive
from kerfgym.experiments.statistics import ranks

DXF = ["0", "SECTION", "2", "ENTITIES"]


def square_dxf(file, side):
    corners = [(0, 0), (side, 0), (side, side), (0, side), (0, 0)]
    lines = list(DXF)
    for (x1, y1), (x2, y2) in zip(corners, corners[1:], strict=False):
        lines += ["0", "LINE", "8", "0", "10", str(x1), "20", str(y1), "11", str(x2), "21", str(y2)]
    file.write_text("\n".join([*lines, "0", "ENDSEC", "0", "EOF"]) + "\n")
    return file


def colours(picture):
    return {tuple(c) for c in np.asarray(picture.convert("RGB")).reshape(-1, 3).tolist()}


def rgb(code):
    return tuple(bytes.fromhex(code[1:]))


# ------------------------------------------------------------------------------------------------------ the picture


def test_render_writes_the_plan_of_a_part(tmp_path, capsys):
    out = tmp_path / "plan.png"
    cli.main(["render", "--plan", "slot-plate", str(out), "--joints", "2", "--lead-in", "2"])
    seen = colours(Image.open(out))
    for code in (
        plan_picture.PART,
        plan_picture.OUTLINE,
        plan_picture.HOLE,
        plan_picture.LEAD,
        plan_picture.JOINT,
    ):
        assert min(max(abs(a - b) for a, b in zip(rgb(code), c, strict=True)) for c in seen) <= 6, code
    assert capsys.readouterr().out.strip() == str(out)


def test_the_plan_of_a_drawing_says_what_a_user_should_know(tmp_path, capsys):
    slit = tmp_path / "slit.svg"
    slit.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="40mm" height="40mm" viewBox="0 0 40 40">'
        '<path d="M0 0H40V40H0Z"/><path d="M10 10H30V10.05H10Z"/></svg>'
    )
    cli.main(["render", "--plan", str(slit), str(tmp_path / "plan.png")])
    first, *notes = capsys.readouterr().err.splitlines()
    assert first == f"kerfgym: {slit}: 2 contours, 200.1 mm to cut, 40.00 × 40.00 mm, read in mm"
    assert all(note.startswith(f"kerfgym: {slit}: ") for note in notes)
    assert notes[-1].endswith("has no room for a lead-in: it is pierced on the contour")


def far_away(tmp_path):
    """A bow tie in a plate and two small holes, 1 km away from the origin, drawn in cm; the smaller hole is narrower
    than 0.3 mm."""
    space = ezdxf.new("R2010")
    space.header["$INSUNITS"] = 5
    model = space.modelspace()
    for ring in ([(0, 0), (10, 0), (10, 10), (0, 10)], [(2, 2), (8, 8), (8, 2), (2, 8)]):
        model.add_lwpolyline([(100_000 + x, 5 + y) for x, y in ring], close=True)
    model.add_circle((100_001, 6), 0.01)
    model.add_circle((100_005, 13), 0.025)
    space.saveas(tmp_path / "far.dxf")
    return scenarios.load("contour-square").along(tmp_path / "far.dxf").varied(job={"kerf": 0.3})


def test_picture_and_messages_have_the_numbers_and_places_of_the_file(tmp_path):
    route = workshop.route_of(far_away(tmp_path))
    assert min(p.min() for p in route.drawing.pieces) == 0.0  # the machine has it in its corner
    told = [*route.drawing.notes, *route.warnings]
    (gone,) = [line for line in told if line.endswith("vanishes: it is left out at a kerf of 0.3 mm")]
    assert "which begins at x = 1000010.10, y = 60.00 mm" in gone
    assert any("contour 2 crosses or touches itself at x = 1000050.00, y = 100.00 mm" in line for line in told)
    page = plan_picture.figure(route)
    (axes,) = page.axes
    numbers = {text.get_text(): text.get_position() for text in axes.texts}
    assert (
        set(numbers)
        == {str(route.drawing.number(cut.contour)) for cut in route.cuts}
        == {*"1234"} - {gone.split()[1][0]}
    )
    for cut in route.cuts:
        place = numbers[str(route.drawing.number(cut.contour))]
        assert np.hypot(*(cut.way[0] + route.drawing.origin - place)) < 5.0
    marks = [line for line in axes.lines if line.get_marker() == "x"]
    assert np.concatenate([line.get_xydata() for line in marks]) == pytest.approx(np.array([[1000050.0, 100.0]]))
    assert "drawn in cm" in "".join(text.get_text() for text in page.texts)


def test_both_lobes_of_a_bow_tie_are_scrap_in_the_picture(tmp_path):
    page = plan_picture.figure(workshop.route_of(far_away(tmp_path)))
    width, height = (int(q) for q in page.get_size_inches() * page.dpi)
    seen = np.asarray(Image.open(io.BytesIO(png(page))).convert("RGB")).reshape(height, width, 3)
    (axes,) = page.axes

    def at(x, y):
        column, row = axes.transData.transform((1_000_000 + x, 50 + y))
        return tuple(int(q) for q in seen[height - 1 - int(row), int(column)])

    assert at(30, 55) == at(72, 60) == (255, 255, 255)
    for place in ((50, 70), (50, 30)):
        assert at(*place) == pytest.approx(rgb(plan_picture.PART), abs=6)


def test_folders_of_drawings_are_read_without_an_option(tmp_path):
    from kerfgym.experiments.studies.leads.__main__ import main

    parsed = {}

    @functools.wraps(main)
    def instead(*args, **given):
        parsed.update(given)

    tyro.cli(instead, args=[str(tmp_path), "--contours", "10"])
    assert (parsed["folders"], parsed["contours"]) == ((tmp_path,), 10)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--plan", "gaer", "a.png"], "unknown part 'gaer'; did you mean 'gear'"),
        (["--plan", "gear", "a.jpg"], "cannot write 'a.jpg'; did you mean '.png'"),
        (["--plan", "gear", "a.png", "--lead-in", "60"], "lead_in = 60.0 is out of range; allowed: 0 to 50 mm"),
        (["--plan", "nothing.dxf", "a.png"], "nothing.dxf: no such file"),
        (["-s", "wavy", "a.png", "--kerf", "0.2"], "--kerf: scenario 'wavy' cuts nothing; allowed: scenarios with"),
    ],
)
def test_what_cannot_be_planned_is_an_error(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as error:
        cli.main(["render", *words])
    assert error.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("small", [False, True])
def test_a_millimetre_is_as_long_in_x_as_in_y(small):
    for made in (part("square", side=5.0), part("slot-plate", width=400.0, height=20.0)):
        page = plan_picture.figure(routed(made, Cutting()), small=small)
        (axes,) = page.axes
        (x, y), (x1, y1) = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
        assert x1 - x == pytest.approx(y1 - y)
        width = Image.open(io.BytesIO(png(page))).size[0]
        assert width == (837 if small else 1800)


def test_options_change_the_job_of_every_scenario():
    (grid,) = grids.plan(
        ["contour"], ["wu"], ["contour-square", "contour-circle"], cut_as={"lead_in": 1.5, "joints": 2}
    )
    assert [(s.job.lead_in, s.job.joints) for s in grid.scenarios] == [(1.5, 2)] * 2
    assert len(workshop.route_of(grid.scenarios[0]).joints) == 2


def test_a_users_drawing_finds_a_machine_as_large_as_a_sheet(tmp_path):
    (case,) = grids.along(square_dxf(tmp_path / "large.dxf", 1900.0), [scenarios.load("contour-square")], "contour")
    assert workshop.route_of(case).drawing.bounds[1] == pytest.approx([1900.0, 1900.0])
    with pytest.raises(InvalidInput, match="allowed: the travel of 1500 × 1000 mm"):
        workshop.route_of(case.varied(gantry={"travel_x": 1500.0, "travel_y": 1000.0}))


# ---------------------------------------------------------------------------------------------------- in the report


def test_plans_are_kept_with_a_run_and_shown_before_its_results(tmp_path):
    chosen = [
        scenarios.load("contour-circle").varied(job={"size": 6.0}),
        scenarios.load("contour-square").varied(job={"size": 6.0}),
    ]
    benchmarking.run(["wu"], chosen, tmp_path / "run", (1000,), suite="contour", workers=1, quiet=True)
    kept = archive.load(tmp_path / "run").grids["contour"].plans
    assert kept["scenarios"].tolist() == ["contour-circle", "contour-square"]
    assert kept["cuts"].tolist() == [1, 1]
    for picture in kept["picture"]:
        assert Image.open(io.BytesIO(picture)).size[0] > 500
    text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert 0 < text.index('id="plan"') < text.index('id="suite-contour"')
    assert text.count('<img src="data:image/png;base64,') == 2


def test_scenarios_with_the_same_part_share_a_plan():
    chosen = [scenarios.load(name) for name in ("contour-circle", "contour-one-way", "contour-square")]
    assert plans.table(chosen)["scenarios"].tolist() == ["contour-circle, contour-one-way", "contour-square"]


# ------------------------------------------------------------------------------------------- small, and all failed


def test_a_square_of_5_mm_is_scored(tmp_path):
    (case,) = grids.along(square_dxf(tmp_path / "small.dxf", 5.0), [scenarios.load("drawing")], "drawing")
    assert case.duration == pytest.approx(0.2, abs=0.002)
    results = benchmarking.run(
        ["pid"], [case], tmp_path / "run", (1000, 1001), suite="drawing", workers=1, quiet=True, with_ms=False
    )
    assert not results.failures.any()
    assert results.standings.at["pid", "rank"] == 1.0


def test_a_drawing_that_takes_no_time_is_refused_with_its_time(tmp_path):
    with pytest.raises(InvalidInput, match=r"takes 0\.02 s at 100 mm/s; allowed: 0\.05 to 600 s; a slower feed"):
        scenarios.load("drawing").along(square_dxf(tmp_path / "tiny.dxf", 0.5))


def test_where_all_runs_failed_nobody_has_a_rank_and_the_reason_is_told():
    class All:
        controllers, scored, core, metric, reference = ["a", "b"], ["one"], ("one",), "rms_true", "a"
        meta, exempt = {}, ()
        runs = pd.DataFrame(
            {
                "controller": ["a", "a", "b", "b"],
                "information": "sensor",
                "scenario": "one",
                "seed": [0, 1, 0, 1],
                "failed": True,
                "collision": [0.0, 1.0, 0.0, 0.0],
                "rms_true": np.nan,
            }
        )

    frame = ranks.standings(All())
    assert frame["rank"].isna().all()
    assert frame["reasons"]["b"][-1] == "all of its 2 runs failed: nothing was scored, or a number was not finite"
    assert "the nozzle touched the sheet (1)" in frame["reasons"]["a"][-1]
