"""The report in a real browser: it opens from disk, asks for nothing, moves, copies, and everybody can use it."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from report_drives import hostile
from skidsteer.drive import Drive
from skidsteer.identify.calibrate import CalibrateOptions, calibrate_with_folds
from skidsteer.io.drives import load_drive
from skidsteer.report import gather, write_report
from skidsteer.se2 import between, compose, invert

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
if not os.environ.get("SKIDSTEER_BROWSER"):  # else they must run
    pytest.importorskip("playwright.sync_api", reason="no playwright here")
    pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here")
sync_api = importlib.import_module("playwright.sync_api")

QUIET = ("quic", "gpu", "background-networking", "component-update", "sync")
FLAGS = ["--no-sandbox", "--no-first-run", *(f"--disable-{what}" for what in QUIET)]
DESKTOP, PHONE = {"width": 1280, "height": 900}, {"width": 360, "height": 780}
NAMES = ("warthog-asphalt", "husky-mocap", "warthog-sand-windows", "sample:p3at-mandow")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


def short(drive: Drive) -> Drive:
    """Enough of a drive for a report."""
    if drive.segments is not None:
        return drive.with_segments(np.arange(0, len(drive.segments), 4))
    return drive.between(drive.span[0], drive.span[0] + 150.0)


@pytest.fixture(scope="module")
def report(real: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The report of a drive by name; the test is skipped where a real drive is not there."""
    folder = tmp_path_factory.mktemp("reports")

    @cache
    def write(name: str) -> Path:
        drive = short(load_drive(name if name.startswith("sample:") else real(name)))
        calibration, folds = calibrate_with_folds([drive], CalibrateOptions(model="icr"))
        path = folder / f"{drive.name}.html"
        write_report(gather(calibration, [drive], folds=folds), path)
        return path

    return write


class Page:
    """An open page, and what it said and asked for."""

    def __init__(self, browser: Any, path: Path, size: dict[str, int], theme: str = "light") -> None:
        self.context = browser.new_context(viewport=size, color_scheme=theme, permissions=["clipboard-read"])
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda message: self.said.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready]", timeout=60_000)


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Page]]:
    pages: list[Page] = []

    def go(path: Path, size: dict[str, int] = DESKTOP, theme: str = "light") -> Page:
        pages.append(Page(browser, path, size, theme))
        return pages[-1]

    yield go
    for page in pages:
        page.context.close()


def path_drawn(page: Any) -> str:
    """The outlines of all lines in the picture of the paths."""
    found: str = page.evaluate(
        "[...document.querySelectorAll('#chart-track .js-line')].map(p => p.getAttribute('d')).join()"
    )
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_report_opens_from_disk_says_nothing_wrong_and_asks_for_nothing(
    name: str, report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    seen = visit(report(name))
    assert not seen.said
    assert [url for url in seen.asked if not url.startswith(("data:", "blob:"))] == [report(name).as_uri()]
    charts = seen.page.locator(".chart")
    assert charts.count() >= 6
    drawn = seen.page.evaluate(
        "[...document.querySelectorAll('.chart')].filter(c => c.querySelector('svg.main-svg')).length"
    )
    assert drawn == charts.count()


@pytest.mark.parametrize("name", ["sample:p3at-mandow", "warthog-sand-windows"])
def test_the_slider_moves_the_robot(name: str, report: Callable[[str], Path], visit: Callable[..., Page]) -> None:
    page = visit(report(name)).page
    before, clock = path_drawn(page), page.locator("#clock").text_content()
    page.locator("#time").focus()
    for _ in range(12):
        page.keyboard.press("PageDown")
    sync_api.expect(page.locator("#clock")).not_to_have_text(clock)
    assert path_drawn(page) != before
    assert "calibrated" in page.locator("#readout").text_content()


def test_beginning_anew_more_often_brings_dead_reckoning_nearer(
    report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    page = visit(report("sample:p3at-mandow")).page
    whole = path_drawn(page)
    off = {}
    for every in ("0", "2"):
        page.locator(f'input[name="restart"][value="{every}"]').check(force=True)
        words = page.locator("#readout .is-nominal").text_content()
        off[every] = float(words.split(":")[1].split("m")[0])
    assert path_drawn(page) != whole
    assert off["2"] < 0.5 * off["0"]


@pytest.mark.parametrize("every", [5, 10])
def test_the_page_begins_anew_as_it_should(
    every: int, report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    """What it says at the end of the drive, computed here: the last stretch, moved onto the reference at its start."""
    text = report("sample:p3at-mandow").read_text()
    told = json.loads(text.split('id="data">')[1].split("</script>")[0])["tracks"][0]
    t, poses = np.array(told["t"]), {name: np.array(values).T for name, values in told["poses"].items()}
    first = 0
    while (later := np.flatnonzero(t - t[first] >= every - 1e-6)).size and later[0] < len(t) - 1:
        first = int(later[0])
    page = visit(report("sample:p3at-mandow")).page
    page.locator(f'input[name="restart"][value="{every}"]').check(force=True)
    for name in ("nominal", "calibrated"):
        moved = compose(poses["reference"][first], compose(invert(poses[name][first]), poses[name][-1]))
        error = between(poses["reference"][-1], moved)
        said = page.locator(f"#readout .is-{name}").text_content()
        metres, degrees = (float(word) for word in re.findall(r"[0-9.]+(?= m|°)", said))
        assert abs(metres - np.hypot(error[0], error[1])) < 0.006
        assert abs(degrees - abs(np.degrees(error[2]))) < 0.06


def test_the_copy_button_copies_the_configuration(report: Callable[[str], Path], visit: Callable[..., Page]) -> None:
    page = visit(report("sample:p3at-mandow")).page
    page.locator("#copy").click()
    sync_api.expect(page.locator("#copied")).to_have_text("Copied.")
    pasted = page.evaluate("navigator.clipboard.readText()")
    assert pasted == page.locator("#yaml").text_content()
    assert "wheel_separation_multiplier" in pasted


def test_light_and_dark_follow_the_system_and_the_button(
    report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    page = visit(report("sample:p3at-mandow"), theme="dark").page
    paper = "getComputedStyle(document.body).backgroundColor"
    line = "document.querySelector('#chart-track .js-line').style.stroke"
    dark, drawn = page.evaluate(paper), page.evaluate(line)
    page.locator("#theme").click()
    assert page.evaluate(paper) == "rgb(255, 255, 255)" != dark
    assert page.evaluate(line) != drawn


def test_paper_is_white_and_narrower(report: Callable[[str], Path], visit: Callable[..., Page]) -> None:
    page = visit(report("sample:p3at-mandow"), theme="dark").page
    widths = "Math.max(...[...document.querySelectorAll('svg.main-svg')].map(s => s.getBoundingClientRect().width))"
    screen = page.evaluate(widths)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate(widths) <= 670 < screen
    page.emulate_media(media="screen")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    sync_api.expect(page.locator("#theme")).to_have_text("Light")


@pytest.mark.parametrize("name", ["sample:p3at-mandow", "warthog-sand-windows"])
def test_a_phone_needs_no_scrolling_sideways(
    name: str, report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    page = visit(report(name), PHONE).page
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert page.locator(".sentence").bounding_box()["y"] < PHONE["height"]


@pytest.mark.parametrize(
    ("name", "size", "theme"), [("warthog-asphalt", DESKTOP, "light"), ("sample:p3at-mandow", PHONE, "dark")]
)
def test_everybody_can_use_it(
    name: str, size: dict[str, int], theme: str, report: Callable[[str], Path], visit: Callable[..., Page]
) -> None:
    """No serious or critical violation by axe-core."""
    axe = importlib.import_module("axe_playwright_python.sync_playwright")
    found = axe.Axe().run(visit(report(name), size, theme).page, options={"resultTypes": ["violations"]})
    bad = [v for v in found.response["violations"] if v["impact"] in ("serious", "critical")]
    assert not [(v["id"], [node["html"][:200] for node in v["nodes"]]) for v in bad]


def test_what_a_log_is_called_does_not_run(visit: Callable[..., Page], tmp_path: Path) -> None:
    calibration, drives = hostile()
    path = tmp_path / 'it\'s <i>"a" report.html'
    write_report(gather(calibration, drives), path)
    seen = visit(path)
    assert not seen.said
    assert len(seen.asked) == 1
    assert seen.page.evaluate("window.hurt === undefined && !document.querySelector('main img, main iframe, .chart a')")
    assert seen.page.locator("h1").text_content() == calibration.vehicle.name
