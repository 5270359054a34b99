"""Pictures: what is read off them is what the scene says."""

import subprocess
import sys
import warnings
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.pictures import rendering
from kerfgym.envs.pictures.rendering import (
    EXAGGERATIONS,
    MODES,
    NOZZLE,
    OVERRIDE,
    REPORTED,
    STEEL,
    TRUE,
    Renderer,
    Scene,
)
from kerfgym.envs.plant import sensor, supervisor

LOWER = 340
"""px, a row between the panels of a frame of 960×540."""


def scene(gap=0.5, time=3.0, true=None, hole=None, **changes):
    """Follows a level sheet at 200 mm/s; ``true``: error over time, mm; ``hole``: from, to, mm from the nozzle."""
    past = np.arange(max(0.0, time - 0.999), time + 1e-9, 1e-3)
    error = np.zeros(len(past)) if true is None else true(past)
    x = np.arange(-15.0, 15.01, 0.2)
    void = (x > hole[0]) & (x < hole[1]) if hole else np.zeros(len(x), bool)
    usual = Scene(
        time=time,
        distance=200.0 * time,
        ahead=np.column_stack([200.0 * time + x, np.full(len(x), 2.0)]),
        void=void,
        head=2.0 + gap,
        gap=gap,
        set_height=0.5,
        reported=gap,
        mode="follow",
        override=False,
        trace=np.column_stack([past, error, error + 0.004]),
        title="flat · xi2023-improved",
    )
    return replace(usual, **changes)


def where(picture, colour):
    """Rows and columns of the pixels of that colour."""
    return np.nonzero((picture == list(bytes.fromhex(colour[1:]))).all(axis=2))


def tip(picture):
    return where(picture, NOZZLE)[0].max()


def px_per_mm(picture):
    """Scale of x, from the width of the nozzle's face."""
    rows, columns = where(picture, NOZZLE)
    return (np.ptp(columns[rows == rows.max()]) + 1) / (2 * sensor.Params().radius)


@pytest.fixture
def texts(monkeypatch):
    """Keeps what is written: text and its box (left, top, right, bottom), px."""
    kept, write = [], rendering._Letters.write

    def keep(self, page, text, x, y, colour, align=0.0, **more):
        end = write(self, page, text, x, y, colour, align, **more)
        kept.append((text, (end - self.width(text), y - 0.45 * self._above, end, y + 0.45 * self._above)))
        return end

    monkeypatch.setattr(rendering._Letters, "write", keep)
    return kept


def test_frames_have_the_size_asked_for():
    for width, height in ((960, 540), (640, 360), (480, 270), (900, 900)):
        picture = Renderer(width, height).frame(scene())
        assert picture.shape == (height, width, 3)
        assert picture.dtype == np.uint8
    with pytest.raises(InvalidInput, match="480×270 and up"):
        Renderer(320, 200)


def test_the_same_scenes_give_the_same_pictures():
    scenes = [scene(gap, time) for gap, time in ((3.0, 0.4), (0.7, 1.0), (0.5, 3.0), (0.5, 3.02))]
    a, b = Renderer(), Renderer()
    for s in scenes:
        assert (a.frame(s) == b.frame(s)).all()


def test_a_new_episode_forgets_the_last():
    used = Renderer()
    used.frame(scene(9.0, 5.0))
    assert (used.frame(scene(0.5, 0.1)) == Renderer().frame(scene(0.5, 0.1))).all()


def test_a_frame_is_not_changed_by_the_next():
    renderer = Renderer()
    first = renderer.frame(scene(0.5))
    kept = first.copy()
    renderer.frame(scene(0.6))
    assert (first == kept).all()


def test_the_gap_is_drawn_to_the_scale_stated(texts):
    near, far = (Renderer().frame(scene(gap)) for gap in (0.4, 0.5))
    stated = {text for text, _ in texts if "drawn" in text}
    assert stated == {"height z, mm (drawn z × 8)"}
    assert tip(near) - tip(far) == pytest.approx(0.1 * 8 * px_per_mm(far), abs=1)
    surface = where(far, STEEL)[0].min()
    assert surface - tip(far) == pytest.approx(0.5 * 8 * px_per_mm(far), abs=3)


def test_far_above_the_sheet_nozzle_and_sheet_stay_in_sight():
    for gap in (15.0, 50.0, 100.0, 500.0):
        picture = Renderer().frame(scene(gap))
        assert len(where(picture, NOZZLE)[0]) > 1000
        assert len(where(picture, STEEL)[0]) > 10_000


def test_a_dive_into_a_hole_stays_in_sight(texts):
    picture = Renderer().frame(scene(-5.6, hole=(-12, 12)))
    assert where(picture, STEEL)[0].min() < tip(picture) < LOWER - 15
    assert "gap −5.600 mm" in [text for text, _ in texts]


def test_the_scale_does_not_flicker_about_a_limit():
    renderer, seen = Renderer(), []
    for i, gap in enumerate(np.tile([0.63, 0.68], 100)):
        renderer.frame(scene(gap, 3.0 + 0.02 * i))
        seen.append(renderer._spans[renderer._span])
    assert np.count_nonzero(np.diff(seen)) <= 1


def test_steps_hold_what_they_must_and_let_go_late():
    steps, now = (20.0, 50.0, 100.0), 0.0
    for need, expected in ((5, 20), (20, 20), (21, 50), (19, 50), (16.1, 50), (16, 20), (70, 100), (999, 100), (0, 20)):
        now = rendering._step(steps, now, need)
        assert now == expected


def test_a_hole_is_empty_and_as_wide_as_it_is():
    whole, holed = (Renderer().frame(scene(hole=hole)) for hole in (None, (3.0, 9.0)))
    bottom = LOWER - 25
    steel = [(picture[bottom] == list(bytes.fromhex(STEEL[1:]))).all(axis=1) for picture in (whole, holed)]
    assert np.count_nonzero(steel[0] & ~steel[1]) == pytest.approx(6.0 * px_per_mm(whole), abs=0.3 * px_per_mm(whole))


def test_true_and_reported_error_are_seen():
    sine = Renderer().frame(scene(true=lambda t: 0.015 * np.sin(20 * t)))
    none = Renderer().frame(scene(trace=np.zeros((0, 3))))
    for colour in (TRUE, REPORTED):
        seen, legend = (np.count_nonzero(where(picture, colour)[0] > LOWER) for picture in (sine, none))
        assert seen > legend + 300


def test_the_error_is_drawn_where_it_is():
    zero, up, down = (Renderer().frame(scene(true=lambda t, e=e: 0 * t + e)) for e in (0.0, 0.01, -0.01))
    rows = []
    for picture in (zero, up, down):
        row, column = where(picture, TRUE)
        rows.append(np.median(row[(row > LOWER) & (column < 800)]))
    # ±10 of ±20 µm are a quarter of the panel of 114 px, up or down.
    assert rows[0] - rows[1] == pytest.approx(28.5, abs=2)
    assert rows[2] - rows[0] == pytest.approx(28.5, abs=2)


def test_the_error_is_drawn_when_it_was():
    pulse = Renderer().frame(scene(true=lambda t: np.where(np.abs(t - 2.25) < 0.01, 0.015, 0.0)))
    row, column = where(pulse, TRUE)
    row, column = row[(row > LOWER) & (column < 800)], column[(row > LOWER) & (column < 800)]
    left, right = column.min(), column.max()  # 2 and 3 s
    assert (np.median(column[row < row.min() + 20]) - left) / (right - left) == pytest.approx(0.25, abs=0.02)


def test_a_pause_in_the_trace_is_a_pause_in_the_curve():
    def true(t):
        return np.where((t > 2.4) & (t < 2.6), np.nan, 0.01)

    row, column = where(Renderer().frame(scene(true=true)), TRUE)
    column = np.unique(column[(row > LOWER) & (column < 800)])
    assert np.diff(column).max() == pytest.approx(0.2 * np.ptp(column), rel=0.05)


def test_status_in_words(texts):
    Renderer().frame(scene(0.512, mode="hold", true=lambda t: 0.02 * np.sin(2 * np.pi * 5 * t)))
    written = {text for text, _ in texts}
    assert {"gap 0.512 mm", "3.000 s", "600.0 mm", "holding", "flat · xi2023-improved"} <= written
    assert "14.1 µm" in written  # 20 µm / √2


def test_every_mode_has_a_word():
    assert set(MODES) == set(supervisor.MODES)


def test_the_supervisor_acts_in_words_and_in_colour(texts):
    for override in (True, False):
        texts.clear()
        picture = Renderer().frame(scene(override=override))
        assert any("supervisor acts" in text for text, _ in texts) is override
        assert (len(where(picture, OVERRIDE)[0]) > 1000) is override


@pytest.mark.parametrize("size", [(960, 540), (640, 360), (1920, 1080)])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"gap": 15.0, "time": 0.3, "override": True, "mode": "calibrate"},
        {"gap": 0.01, "time": 12345.678, "mode": "alarm", "override": True},
        {"true": lambda t: 150 * np.sin(t), "title": "wavy · " + "p" * 300},
        {"gap": np.nan, "reported": np.nan, "head": np.nan, "set_height": np.nan, "trace": np.zeros((0, 3))},
    ],
)
def test_texts_do_not_overlap(texts, size, changes):
    Renderer(*size).frame(scene(**changes))
    for (text, a), (other, b) in combinations(texts, 2):
        apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
        assert apart, f"'{text}' at {a} and '{other}' at {b}"
    for text, (left, top, right, bottom) in texts:
        assert left >= 0 <= top, text
        assert right <= size[0], text
        assert bottom <= size[1], text


EMPTY = np.zeros((0, 3))
ODD = np.array([[2.5, np.nan, 1.0], [2.6, 1e12, -np.inf], [2.7, np.nan, np.nan], [np.nan, 0.0, 0.0], [2.9, 0.1, 0.1]])


@pytest.mark.parametrize(
    "changes",
    [
        {"trace": EMPTY},
        {"trace": np.array([])},
        {"trace": ODD},
        {"trace": np.full((1000, 3), np.nan)},
        {"trace": np.array([[3.0, 0.01, 0.01]])},
        {"trace": np.array([[99.0, 0.01, 0.01]])},
        {"true": lambda t: 1e9 * np.sin(50 * t)},
        {"hole": (-99, 99)},
        {"hole": (-99, 99), "gap": -3.0},
        {"ahead": np.zeros((0, 2)), "void": np.zeros(0, bool)},
        {"ahead": np.array([[600.0, 2.0]]), "void": np.array([False])},
        {"ahead": np.full((5, 2), 600.0), "void": np.zeros(5, bool)},
        {"ahead": np.array([[590.0, np.nan], [610.0, 2.0]]), "void": np.zeros(2, bool)},
        {"ahead": np.array([[590.0, -1e6], [610.0, 1e6]]), "void": np.zeros(2, bool)},
        {"gap": 0.0},
        {"gap": 1e6},
        {"gap": -1e6},
        {"gap": np.nan},
        {"gap": np.inf},
        {"head": np.nan},
        {"reported": np.nan},
        {"reported": 1e9},
        {"set_height": np.nan},
        {"time": 0.0},
        {"mode": "thinking"},
        {"title": ""},
        {"title": "w" * 5000},
    ],
)
def test_odd_scenes_are_drawn_without_a_warning(changes):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer = Renderer()
        for _ in range(2):
            assert renderer.frame(scene(**changes)).shape == (540, 960, 3)


def test_the_scales_are_steps_of_two():
    assert np.allclose(np.diff(np.log2(EXAGGERATIONS)), -1)


def test_pillow_is_imported_when_it_is_needed():
    code = "import sys, kerfgym, kerfgym.envs.pictures.rendering; sys.exit('PIL' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
