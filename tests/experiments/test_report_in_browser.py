"""The report in a real Chromium without network: nothing complains, nothing is asked for, what can be used works."""

import shutil
import types

import numpy as np
import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as p:
        found = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def opened(browser, whole_run):
    """The page at 1400 px after it was read from top to end, with what the browser had to say of it."""
    context = browser.new_context(viewport={"width": 1400, "height": 900}, offline=True)
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(str(error)))
    context.on("request", lambda request: asked.append(request.url))
    page.goto(whole_run.path.as_uri())
    ids = page.eval_on_selector_all("figure", "all => all.map(f => f.id)")
    for figure in ids:
        page.locator(f"figure[id='{figure}']").scroll_into_view_if_needed()
        page.wait_for_selector(f"figure[id='{figure}'][data-drawn] .main-svg")
    yield types.SimpleNamespace(page=page, said=said, asked=asked, figures=ids, run=whole_run)
    context.close()


@pytest.fixture
def page(opened):
    return opened.page


def plotted(page, figure):
    """Data and layout of a figure as they are drawn."""
    return page.evaluate(
        """id => { const c = document.querySelector(`figure[id='${id}'] .canvas`);
        return { data: c.data.map(t => ({ ...t, y: t.y && Array.from(t.y) })), range: c._fullLayout.xaxis.range,
                 axes: Object.keys(c._fullLayout).filter(k => /^[xy]axis/.test(k)) }; }""",
        figure,
    )


def column(page, table, index):
    return page.eval_on_selector_all(
        f"#{table} tbody tr", "(rows, i) => rows.map(r => r.cells[i].dataset.value)", index
    )


def test_nothing_is_asked_for_but_the_page(opened):
    assert {url for url in opened.asked if not url.startswith(("data:", "blob:"))} == {opened.run.path.as_uri()}
    assert {f"scores-{suite}" for suite in opened.run.grids} <= set(opened.figures)


def test_a_click_sorts_the_table_and_the_third_brings_the_first_order_back(page):
    head = page.locator("#table-following thead tr:last-child th").nth(3)
    first = column(page, "table-following", 3)
    head.locator("button").click()
    rising = [float(value) for value in column(page, "table-following", 3)]
    assert rising == sorted(rising) != [float(value) for value in first]
    assert head.get_attribute("aria-sort") == "ascending"
    head.locator("button").click()
    assert [float(value) for value in column(page, "table-following", 3)] == rising[::-1]
    head.locator("button").click()
    assert column(page, "table-following", 3) == first
    assert head.get_attribute("aria-sort") is None


def test_names_are_sorted_as_words_and_what_is_missing_stays_below(page):
    head = page.locator("#table-following thead tr:last-child th")
    head.nth(0).locator("button").click()
    names = page.locator("#table-following tbody th").all_inner_texts()
    assert [name.split()[0] for name in names] == ["pid", "preview-5ms", "xi2023-tuned"]
    head.nth(0).locator("button").click()
    titles = head.all_inner_texts()
    median = next(i for i, title in enumerate(titles) if title.split()[:2] == ["time", "µs,"])
    for _ in range(2):
        head.nth(median).locator("button").click()
        assert column(page, "table-following", median)[1:] == ["", ""]
    head.nth(median).locator("button").click()


def test_groups_of_columns_can_be_hidden(page):
    cell = page.locator("#table-following td.g1").first
    assert cell.is_visible()
    page.locator(".switches[data-table=table-following] input").first.uncheck()
    assert not cell.is_visible()
    page.locator(".switches[data-table=table-following] input").first.check()
    assert cell.is_visible()


def test_a_menu_chooses_what_a_figure_shows(page):
    before = plotted(page, "heat-following")["data"][0]["text"]
    page.select_option("figure#heat-following select", label="dross, mm")
    after = plotted(page, "heat-following")["data"][0]["text"]
    assert before[0][0] == "5.66"
    assert after[0][0] == "0.0506"  # 0.05 mm + 10⁻⁴ mm/µm · 5.66 µm


def shown(page, words):
    """Waits until the oscilloscope shows these words: scenario, seed, controllers."""
    page.wait_for_selector(f"#oscilloscope[data-shown='{words}']")


def test_the_oscilloscope_shows_what_was_recorded(opened, page):
    shown(page, "wavy 1000 pid xi2023-tuned preview-5ms")
    page.select_option("#oscilloscope select[name=scenario]", label="holes")
    page.select_option("#oscilloscope select[name=seed]", label="1001")
    for name in ("pid", "preview-5ms"):
        page.locator(f"#oscilloscope input[value='{name}']").uncheck()
    shown(page, "holes 1001 xi2023-tuned")
    page.click("#oscilloscope button")  # the whole run
    traces = opened.run.grids["following"].traces
    run = traces[(traces["scenario"] == "holes") & (traces["seed"] == 1001) & (traces["controller"] == "xi2023-tuned")]
    drawn = plotted(page, "oscilloscope")
    signals = [
        run["surface"],
        1e3 * (run["gap"] - run["set_height"]),
        1e3 * (run["height"] - run["set_height"]),
        run["command"],
        run["velocity"],
    ]
    assert len(drawn["data"]) == len(signals)
    for trace, signal, step in zip(drawn["data"], signals, (1e-4, 0.05, 0.05, 0.01, 0.01), strict=True):
        np.testing.assert_allclose(trace["y"], signal, atol=0.51 * step)
    assert drawn["range"] == pytest.approx([0.001, 0.7])


def test_the_oscilloscope_zooms_all_panels_together(page):
    page.select_option("#oscilloscope select[name=scenario]", label="rough")
    page.locator("#oscilloscope input[value='pid']").check()
    page.wait_for_function("document.querySelector('#oscilloscope').dataset.shown.startsWith('rough 1000 pid')")
    low, high = plotted(page, "oscilloscope")["range"]
    panel = page.locator("#oscilloscope .nsewdrag").nth(1)
    panel.scroll_into_view_if_needed()
    box = panel.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.25 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], y, steps=4)
    page.mouse.up()
    page.wait_for_function(
        "low => document.querySelector('#oscilloscope .canvas')._fullLayout.xaxis.range[0] > low + 0.01", arg=low
    )
    drawn = plotted(page, "oscilloscope")
    width = high - low
    np.testing.assert_allclose(drawn["range"], [low + width / 4, low + 3 * width / 4], atol=0.02 * width)
    assert sum(axis.startswith("x") for axis in drawn["axes"]) == 1  # one time for all panels
    page.locator("#oscilloscope input[value='preview-5ms']").check()  # whoever joins is zoomed in on as well
    page.wait_for_function("document.querySelector('#oscilloscope').dataset.shown.endsWith('preview-5ms')")
    assert plotted(page, "oscilloscope")["range"] == pytest.approx(drawn["range"])


def test_the_kerf_takes_the_chosen_colour(page):
    page.select_option("#kerfs select[name=quantity]", label="dross")
    page.wait_for_selector("#kerfs[data-shown='cut-square 1000 dross fine fast']")
    bar = plotted(page, "kerfs")["data"][-1]["marker"]["colorbar"]
    assert bar["title"]["text"] == "dross (mm)"
    page.locator("#kerfs input[value='fast']").uncheck()
    page.wait_for_selector("#kerfs[data-shown='cut-square 1000 dross fine']")
    assert sum(axis.startswith("x") for axis in plotted(page, "kerfs")["axes"]) == 1


def test_it_is_printed_whole_and_as_wide_as_the_paper(page):
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    widths = page.eval_on_selector_all("figure .canvas .main-svg", "all => all.map(svg => svg.width.baseVal.value)")
    assert widths
    assert max(widths) <= 680
    assert page.eval_on_selector_all("details:not(.record details)", "all => all.length && all.every(d => d.open)")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("#scores-following .main-svg").first.bounding_box()["width"] > 1000


def test_on_a_phone_only_tables_and_wide_figures_scroll_sideways(browser, whole_run):
    context = browser.new_context(viewport={"width": 390, "height": 844}, offline=True)
    page = context.new_page()
    page.goto(whole_run.path.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert not page.locator("#table-following td.g5").first.is_visible()  # what can wait is hidden at first
    assert page.locator("#table-following td.g1").first.is_visible()
    page.locator("#scores-following").scroll_into_view_if_needed()
    page.wait_for_selector("#scores-following[data-drawn]")
    assert page.locator("#scores-following .main-svg").first.bounding_box()["width"] <= 360
    context.close()


def test_the_console_stays_empty(opened):
    """Of all that was done above, too."""
    assert opened.said == []
