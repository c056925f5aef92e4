"""Every report page: self-contained, readable on phone, desk and paper, legends in the drawn colours."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest

from beltscape.core.ledger import QUALITIES
from beltscape.measure.lumps.lumps import FINES
from beltscape.report.drawing import legend, palette
from beltscape.report.drawing.charts import Chart, ChartKey, KeyEntry
from beltscape.report.drawing.legend import CERTAINTY, HEIGHT, UNCERTAINTY, Scale, Swatches
from beltscape.report.drawing.plots import NARROW, WIDE, Form, make_panels, to_svg
from beltscape.report.measuring.flow import make_flow_chart, render_flow_page
from beltscape.report.measuring.lumps import (
    BELT,
    OVERSIZE,
    color_by_size,
    crop_to_lumps,
    largest_lumps,
    make_lump_panels,
)
from beltscape.report.page import Section, Table, Tile, Tiles, render
from beltscape.report.plan_drawing import draw_side_view, make_side_charts, make_top_chart
from tests.report.layout import browser, layout_faults, needs_browser, text_faults
from tests.report.material import belt, flow, lumps, pages, plan


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return pages()


def test_every_report_is_one_file_with_tables_that_scroll_and_a_dark_style(made):
    for name, page in made.items():
        assert text_faults(page) == [], name


@pytest.fixture(scope="module")
def opened():
    with browser() as started:
        yield started


@needs_browser
def test_a_browser_shows_all_of_it(made, opened):
    for name, page in made.items():
        assert layout_faults(opened, page) == [], name


@needs_browser
def test_layout_check_detects_a_bad_page(opened):
    wide = Chart('<svg viewBox="0 0 800 50"><text x="5" y="20" font-size="9">small</text></svg>', "", "")
    bare = render("Bad", "", [Section("s", "", [wide])])
    bare = bare.replace(".chart .wide { display: none; }", "").replace(
        "</main>", '<p style="width:2000px;color:#999">wide</p><img src="http://127.0.0.1:9/x.png"></main>'
    )
    faults = "\n".join(layout_faults(opened, bare))
    for what in ("too wide: P", "too small: 3.", "asks for: http://127.0.0.1:9/x.png"):
        assert what in faults
    assert any("elsewhere" in fault for fault in text_faults(bare))
    assert any("1 tables" in fault for fault in text_faults(bare + "<table></table>"))


@pytest.mark.thorough
@needs_browser
def test_tables_that_are_cut_have_a_shadow_and_lone_tiles_do_not_stretch(opened):
    table = Table([f"column {k}" for k in range(20)], [["a"] * 20])
    page_text = render("T", "", [Section("s", "", [table, Tiles([Tile("alone", "1")])])])
    for width, most in ((390, 0.55), (1400, 0.25)):
        page = opened.new_page(viewport={"width": width, "height": 800})
        page.set_content(page_text)
        assert page.evaluate("document.querySelector('.table').scrollWidth > innerWidth")
        shadow = page.evaluate("getComputedStyle(document.querySelector('.table')).backgroundImage")
        assert shadow.count("radial-gradient") == 2
        share = "document.querySelector('.tile').offsetWidth / document.querySelector('.tiles').offsetWidth"
        assert page.evaluate(share) < most
        page.close()


@pytest.mark.thorough
def test_the_same_result_gives_the_same_bytes(made):
    again = pages()
    for name, page in made.items():
        assert again[name] == page, name


def test_roles_have_colours_of_their_own():
    lights = [light for light, _ in palette.ROLES.values()]
    assert len(set(lights)) == len(lights)
    assert palette.css_color(palette.light("degraded")) == "var(--c-degraded)"
    assert palette.css_color("#123456") == "#123456"


def _luminance(color: str) -> float:
    parts = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("dark", [False, True])
def test_what_is_drawn_is_seen_on_its_ground(dark):
    paper = _luminance(palette.ROLES["paper"][dark])
    for role in (*QUALITIES, "first", "second", "third", "fourth", "limit", "core", "auxiliary", "common"):
        own = _luminance(palette.ROLES[role][dark])
        assert (max(own, paper) + 0.05) / (min(own, paper) + 0.05) >= 2.8, role


def test_a_chart_has_in_both_forms_the_colours_of_its_key():
    (two_side, along), top = make_side_charts(plan()), make_top_chart(plan())
    from beltscape.report.measuring.belt import make_section_chart

    for chart in (two_side, along, top, make_section_chart(belt()), make_flow_chart(flow().records)):
        entries = [entry for key in chart.legends if isinstance(key, ChartKey) for entry in key.entries]
        assert entries
        for entry in entries:
            color = palette.variable(entry.role)
            assert color in entry.sample
            assert color in chart.wide and color in chart.narrow, entry


def test_states_have_swatches_and_shapes():
    page = render_flow_page(flow(), warnings=())
    for quality in QUALITIES:
        rows = re.findall(rf'<td class="state">(<svg class="sample".*?</svg>){quality}</td>', page)
        assert len(rows) == 1 + 24 // len(QUALITIES)  # what it means, and the strips that have it
        assert all(palette.variable(quality) in row for row in rows)
    assert len({KeyEntry("", "ink", mark).sample for mark in ("circle", "square", "triangle", "cross")}) == 4


def test_the_plans_side_views_have_one_scale():
    for form in (WIDE, NARROW):
        scales = [
            float(re.findall(r'data-px-per-mm="([\d.]+)"', draw_side_view(plan(), form, along=along))[0])
            for along in (False, True)
        ]
        assert scales[0] == scales[1] > 0
        for along, scale in zip((False, True), scales, strict=True):
            svg = draw_side_view(plan(), form, along=along)
            name = f"full width over {plan().motion.frame_length_mm:.0f} mm" if along else "span 780 mm"
            line = re.findall(rf'<polyline points="([\d.,\- ]+)"(?:(?!polyline).)*?{name}', svg)[-1]
            (x0, _), (x1, _) = (map(float, point.split(",")) for point in line.split())
            length = plan().motion.frame_length_mm if along else 780.0
            assert (x1 - x0) / length == pytest.approx(scale, rel=0.01)


def test_the_picture_has_the_numbers_of_the_table(made):
    found, depth, picture = lumps()
    numbers = [str(lump.number) for lump in largest_lumps(found)]
    assert len(numbers) == 12
    for panel in make_lump_panels(found, depth, picture):
        assert [mark.text for mark in panel.marks] == numbers
        for mark, lump in zip(panel.marks, largest_lumps(found), strict=True):
            height, width = panel.image.shape[:2]
            v, u = int(mark.place[1] * height), int(mark.place[0] * width)
            assert found.labels[crop_to_lumps(found)][v, u] == lump.number
    page = made["lumps"]
    rows = re.findall(r"<tr><td>(\d+)</td>", page[page.index("The largest") :])
    assert rows == numbers
    for number in numbers:
        assert len(re.findall(rf'<span class="mark"[^>]*>{number}</span>', page)) == 2


def test_the_lumps_legend_has_the_colours_of_the_picture():
    found, depth, picture = lumps()
    for panel in make_lump_panels(found, depth, picture):
        for each in panel.legends:
            if isinstance(each, Swatches):
                for text, color in each.entries:
                    if not text.startswith("pale"):
                        assert (panel.image == color).all(axis=-1).any(), text
    level = np.ones(found.labels.shape)
    scale = Scale(20.0, 70.0, HEIGHT)
    image = color_by_size(found.labels, found, level, scale)
    assert (image[found.labels == 0] == BELT).all()
    whole = [lump for lump in found.lumps if not lump.occluded and not lump.cut]
    assert whole
    for lump in whole:
        expected = scale.to_rgb(np.array(lump.size_mm))
        assert (image[found.labels == lump.number] == expected).all()
    assert (found.labels != FINES).all() or (image[found.labels == FINES] != BELT).any()
    over = [n for n, chance in found.oversize.lumps if chance > 0.5] if found.oversize else []
    assert over
    key = make_lump_panels(found, depth, picture)[1].legend
    assert isinstance(key, Swatches)
    assert OVERSIZE in [color for _, color in key.entries]


def test_dark_means_certain_on_every_scale(made):
    """σ small and confidence high have the same colour, and the scale says so."""
    np.testing.assert_array_equal(CERTAINTY, UNCERTAINTY[::-1])
    for ramp in (UNCERTAINTY, HEIGHT):
        light = ramp.astype(float) @ [0.299, 0.587, 0.114]
        assert (np.diff(light) > -1.5).all()  # the eye takes brighter for more, in grey print too
        assert light[-1] - light[0] > 120
    assert legend.DARK_IS_CERTAIN in made["plan"]


def test_the_belts_tile_names_what_it_is(made):
    page = made["belt"]
    assert re.search(r'label">σ of the cross-section</span>\s*<span class="value">0\.0123<', page)


def test_a_charts_text_is_text_and_its_numbers_stay():
    def plot(form: Form):
        figure, (axis,) = make_panels(1, form)
        axis.plot([0.12345678, 1], [0, 1], color=palette.light("first"))
        axis.set(title="σ = 0.0012345 mm")
        return figure

    for form in (WIDE, NARROW):
        svg = to_svg(partial(plot), form)
        assert ">σ = 0.0012345 mm</text>" in svg
        assert palette.variable("first") in svg
        assert "font-family" not in svg
        assert not re.search(r"\d\.\d{3}", re.sub(r">[^<]*<", "><", svg))
