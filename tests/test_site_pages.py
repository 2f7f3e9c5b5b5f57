"""The built site: in headless Chromium without a network, at two widths, and link by
link.
"""

import re
import runpy
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pandas as pd
import pytest

PROJECT = Path(__file__).resolve().parents[1]
WIDE, NARROW = 1280, 390  # px: a desk, a phone
LIGHT, FRONT = 2_000_000, 1_000_000  # bytes of a page and all it loads
BROKEN = """async () => {
    const images = [...document.images];
    images.forEach(image => { image.loading = 'eager'; });
    const states = await Promise.allSettled(images.map(image => image.decode()));
    return images.filter((_, k) => states[k].status === 'rejected')
        .map(image => image.src);
}"""
COUNTED = """() => [
    [...document.images]
        // empty: the words beside it say all
        .filter(image => !image.hasAttribute('alt'))
        .map(image => image.src),
    document.querySelectorAll('.math').length,
    document.querySelectorAll('.math svg[aria-label]').length,
]"""
DOLLARS = """() => {
    document.querySelectorAll('.cell_input, pre').forEach(part => part.remove());
    return document.body.innerText.includes('$');
}"""
MACHINE = re.compile(r"(?<![\w.])/(?:tmp|home|root|usr)/.{0,60}|site-packages")
OVERFLOW = (
    "document.scrollingElement.scrollWidth - document.scrollingElement.clientWidth"
)
CUT = """() => [...document.querySelectorAll('.wide, .cell_output, .concluded')]
    .filter(part => part.scrollHeight > part.clientHeight + 1
        && getComputedStyle(part).overflowY !== 'visible').length"""
INK = """() => [...document.querySelectorAll('.admonition')]
    .map(part => getComputedStyle(part).color)"""
FAINT = """() => {
    const numbers = text => text.match(/[0-9.]+/g).map(Number);
    const light = ([r, g, b]) => [r, g, b].map(each => each / 255)
        .map(each => each <= .04 ? each / 12.92 : ((each + .055) / 1.055) ** 2.4)
        .reduce((sum, each, k) => sum + [.2126, .7152, .0722][k] * each, 0);
    const behind = part => {
        for (; part; part = part.parentElement) {
            const colour = numbers(getComputedStyle(part).backgroundColor);
            if (colour.length === 3) return colour;
        }
        return [255, 255, 255];
    };
    return [...document.querySelectorAll('p, td, th, figcaption, summary, h1, h2, pre')]
        .filter(part => part.offsetParent && part.innerText.trim())
        .filter(part => {
            const ink = numbers(getComputedStyle(part).color);
            const pair = [ink, behind(part)].map(light);
            return (Math.max(...pair) + .05) / (Math.min(...pair) + .05) < 4;
        }).slice(0, 3).map(part => part.tagName + ' ' + part.innerText.slice(0, 40));
}"""
TABLES_TOO_WIDE = """() => [...document.querySelectorAll('figure.saved .wide')]
    .filter(part => part.scrollWidth > part.clientWidth + 1)
    .map(part => part.closest('figure').id)"""
TOO_WIDE = """() => [...document.querySelectorAll('body *')]
    .filter(part => part.getBoundingClientRect().right > innerWidth + 1)
    .slice(0, 3).map(part => part.tagName + '.' + part.className)"""


@pytest.fixture(scope="module")
def site(smoke):
    return (smoke / "site").resolve()


class Parsed(HTMLParser):
    """The places of a page, and what it points to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.places, self.targets = {"", "top"}, []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        given = {name: value or "" for name, value in attrs}
        self.places |= {given[name] for name in ("id", "name") if name in given}
        self.targets += [given[name] for name in ("href", "src") if name in given]


@pytest.fixture(scope="module")
def parsed(site):
    return {path: Parsed(path) for path in sorted(site.rglob("*.html"))}


def test_every_link_of_every_page_resolves(site, parsed):
    assert site / "index.html" in parsed
    wrong = []
    for page, link in [
        (page, link) for page, each in parsed.items() for link in each.targets
    ]:
        parts = urlsplit(link)
        path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        if parts.scheme:
            assert parts.scheme in ("https", "mailto", "data"), (page, link)
        elif not path.is_file() or (
            path in parsed and unquote(parts.fragment) not in parsed[path].places
        ):
            wrong.append(f"{page.relative_to(site)}: {link}")
    assert wrong == []


def test_a_page_of_record_stands_beside_that_of_this_run(site, parsed):
    published = PROJECT / "figures"
    name = "table-5-11-detection"
    page = site / "24_all_methods.html"
    assert "run/24_all_methods.html" in parsed[page].targets
    assert "../24_all_methods.html" in parsed[site / "run" / page.name].targets
    for file in (f"{name}.csv", "detection-scores.png"):
        recorded = (published / file).read_bytes()
        assert (site / "figures" / file).read_bytes() == recorded
        assert (site / "run" / "figures" / file).read_bytes() != recorded
    first = pd.read_csv(published / f"{name}.csv", dtype=str)["tp"][0]
    assert f"<td>{first}</td>" in page.read_text()
    # A reduced run says so under its title and cites nothing.
    text = (site / "run" / page.name).read_text()
    assert "at scale quick" in text
    assert "BibTeX" not in text
    assert "BibTeX" in page.read_text()


def test_without_results_of_record_this_run_is_shown_alone(
    tmp_path, smoke, monkeypatch
):
    project = tmp_path / "project"
    for part in ("notebooks", "data/reference"):
        shutil.copytree(PROJECT / part, project / part)
    shutil.copy(PROJECT / "CITATION.cff", project)
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(project))
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(smoke / "figures"))
    generate = runpy.run_path(str(PROJECT / "docs" / "generate.py"))
    pages = tmp_path / "pages"
    banner = generate["write_pages"](smoke / "build", pages, tmp_path / "small")
    assert "No results of record" in banner
    assert "scale quick" in banner
    assert (pages / "24_all_methods.ipynb").is_file()
    assert not (pages / "run").exists()


def test_printed_values_stand_beside_ours_with_their_intervals():
    paired = runpy.run_path(str(PROJECT / "docs" / "generate.py"))["paired"]
    saved = {
        "method": "DBSCAN",
        "tp": "12",
        "f1": "0.61234567",
        "f1_low": "0.5",
        "f1_high": "0.71239",
        "seconds": "2.0",
        "f1_published": "0.61564",
    }
    shown = paired(pd.DataFrame([saved])).iloc[0].to_dict()
    assert [*shown.items()] == [
        ("method", "DBSCAN"),
        ("f1 printed", "0.61564"),
        ("f1 ours", "0.6123 [0.5, 0.712]"),
        ("seconds", "2"),
        ("tp", "12"),
    ]
    plain = {"fraction": "confetti", "error": "-1.25", "low": "-2.123", "high": ""}
    shown = paired(pd.DataFrame([plain, plain | {"high": "3"}]))
    assert shown["error"].tolist() == ["-1.25", "-1.25 [-2.12, 3]"]
    assert list(shown) == ["fraction", "error"]


def test_methods_lead_to_the_code(site):
    methods = (site / "documents" / "methods.html").read_text()
    asked = (PROJECT / "docs" / "methods.md").read_text().count("{py:obj}")
    assert asked == methods.count("xref py py-obj")
    assert asked == len(
        re.findall(
            r'href="[^"]*#(?:module-)?kilnflight[^"]*"[^>]*><code class="xref', methods
        )
    )


def test_no_page_names_a_folder_of_this_machine(parsed):
    for page in parsed:
        assert MACHINE.search(page.read_text()) is None, page


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium without a network."""
    browser_file = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser_file is None:
        pytest.skip("no Chromium on this machine; on Debian: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as run:
        opened = run.chromium.launch(
            executable_path=browser_file, args=["--no-sandbox"]
        )
        context = opened.new_context(offline=True)
        context.set_default_timeout(180_000)  # no test asserts a time
        yield context
        opened.close()


@pytest.fixture(scope="module")
def visits(site, parsed, browser):
    """What a browser found on most pages, opened one after the other in one tab (it is
    faster).

    Of the API, which one template makes, the longest three and those with formulas are
    opened.
    """
    page, requests, problems = browser.new_page(), [], []
    api = sorted((site / "api").glob("*.html"), key=lambda path: path.stat().st_size)
    left_out = {path for path in api[:-3] if 'class="math' not in path.read_text()}
    page.on("request", lambda request: requests.append(request.url))
    page.on("requestfailed", lambda request: problems.append(request.url))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda said: said.type == "error" and problems.append(said.text))
    found = {}
    for path in (path for path in parsed if path not in left_out):
        requests.clear()
        problems.clear()
        visit = found[str(path.relative_to(site))] = look(page, path)
        visit |= {"requests": set(requests), "problems": problems + visit["broken"]}
    page.close()
    return found


def look(page, path):
    """Open a page and look at it at both widths."""
    page.set_viewport_size({"width": WIDE, "height": 900})
    page.goto(path.as_uri(), wait_until="load")
    broken, (unnamed, formulas, drawn) = page.evaluate(BROKEN), page.evaluate(COUNTED)
    too_wide = page.evaluate(TABLES_TOO_WIDE)
    for width in (WIDE, NARROW):
        page.set_viewport_size({"width": width, "height": 900})
        if page.evaluate(OVERFLOW) > 1:
            too_wide += [width, *page.evaluate(TOO_WIDE)]
    unset = drawn != formulas or page.evaluate(DOLLARS)  # mathematics as it was typed
    names = ("broken", "unnamed", "formulas", "unset", "too_wide")
    return dict(zip(names, (broken, unnamed, formulas, unset, too_wide), strict=True))


@pytest.mark.parametrize("what", ["problems", "unset", "too_wide", "unnamed"])
def test_pages_are_whole_and_set_and_fit_the_screen_and_pictures_have_words(
    visits, what
):
    assert {name: visit[what] for name, visit in visits.items() if visit[what]} == {}
    assert any(visit["formulas"] for visit in visits.values())


SHOWN = (
    "index.html",
    "24_all_methods.html",
    "run/24_all_methods.html",
    "numbers.html",
    "search.html",
)


@pytest.mark.parametrize("name", SHOWN)
def test_pages_print_whole_and_read_well_in_the_dark(site, browser, name):
    page, problems = browser.new_page(), []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto((site / name).as_uri(), wait_until="load")
    page.emulate_media(media="print")
    assert page.evaluate(CUT) == 0
    assert set(page.evaluate(INK)) <= {"rgb(0, 0, 0)"}
    assert page.pdf().startswith(b"%PDF")
    page.emulate_media(media="screen", color_scheme="dark")
    assert page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    assert page.evaluate(FAINT) == []
    page.close()
    assert problems == []


def test_the_movie_of_the_front_page_plays(site, browser):
    page = browser.new_page()
    page.goto((site / "index.html").as_uri(), wait_until="load")
    seconds = page.locator("video").evaluate(
        """async film => {
            film.load();
            await film.play();
            return film.duration;
        }"""
    )
    page.close()
    assert seconds > 0.5


def test_pages_are_light_and_nothing_leaves_the_disk(visits):
    for name, visit in visits.items():
        asked = {urlsplit(url) for url in visit["requests"]}
        assert {url.scheme for url in asked} <= {"file", "data", "blob"}, name
        files = {Path(unquote(url.path)) for url in asked if url.scheme == "file"}
        size = sum(path.stat().st_size for path in files if path.is_file())
        assert size <= (FRONT if name == "index.html" else LIGHT), name


@pytest.mark.parametrize("number", ["5.19", "Table 5.17"])
def test_the_search_finds_a_number_and_reads_no_other_page(site, browser, number):
    page, problems = browser.new_page(), []
    page.on(
        "console",
        lambda said: problems.append(said.text) if said.type == "error" else None,
    )
    page.goto(f"{(site / 'search.html').as_uri()}?q={number.replace(' ', '+')}")
    first = page.locator("ul.search li a").first
    first.wait_for()
    first.click()
    assert page.url.split("#")[0].endswith("numbers.html")
    place = page.locator(f"[id='{page.url.partition('#')[2]}']")
    assert (
        number
        in place.locator("xpath=ancestor-or-self::section[1]")
        .locator("h3")
        .inner_text()
    )
    assert problems == []
