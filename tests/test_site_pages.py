"""The built site: in headless Chromium without a network, at two widths, and link by link."""

import re
import shutil
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

PROJECT = Path(__file__).resolve().parents[1]
WIDE, NARROW = 1280, 390  # px: a desk, a phone
LIGHT, FRONT = 2_000_000, 1_000_000  # bytes of a page and all it loads
BROKEN = """async () => {
    const images = [...document.images];
    images.forEach(image => { image.loading = 'eager'; });
    const states = await Promise.allSettled(images.map(image => image.decode()));
    return images.filter((_, k) => states[k].status === 'rejected').map(image => image.src);
}"""
COUNTED = """() => [
    [...document.images]
        .filter(image => !image.hasAttribute('alt'))  // empty: the words beside it say all
        .map(image => image.src),
    document.querySelectorAll('.math').length,
    document.querySelectorAll('.math svg[aria-label]').length,
]"""
DOLLARS = """() => {
    document.querySelectorAll('.cell_input, pre').forEach(part => part.remove());
    return document.body.innerText.includes('$');
}"""
MACHINE = re.compile(r"(?<![\w.])/(?:tmp|home|root|usr)/.{0,60}|site-packages")
OVERFLOW = "document.scrollingElement.scrollWidth - document.scrollingElement.clientWidth"
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


def target(page: Path, link: str) -> tuple[Path, str] | None:
    """The file and the place in it that a link leads to; nothing if it leaves the site."""
    parts = urlsplit(link)
    if parts.scheme:
        return None
    path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    return path, unquote(parts.fragment)


def test_every_link_of_every_page_resolves(site, parsed):
    assert site / "index.html" in parsed
    wrong = []
    for page, content in parsed.items():
        for link in content.targets:
            found = target(page, link)
            if found is None:
                assert urlsplit(link).scheme in ("https", "mailto", "data"), (page, link)
            elif not found[0].is_file() or (
                found[0] in parsed and found[1] not in parsed[found[0]].places
            ):
                wrong.append(f"{page.relative_to(site)}: {link}")
    assert wrong == []


def test_methods_lead_to_the_code(site):
    methods = (site / "documents" / "methods.html").read_text()
    asked = (PROJECT / "docs" / "methods.md").read_text().count("{py:obj}")
    assert asked == methods.count("xref py py-obj")
    assert asked == len(
        re.findall(r'href="[^"]*#(?:module-)?kilnflight[^"]*"[^>]*><code class="xref', methods)
    )


def test_no_page_names_a_folder_of_this_machine(site, parsed):
    found = {page.relative_to(site): MACHINE.search(page.read_text()) for page in parsed}
    assert {str(page): at[0] for page, at in found.items() if at} == {}


@dataclass
class Visit:
    """What a browser found on a page."""

    requests: set[str] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)  # requests and scripts that failed
    too_wide: dict[int, list[str]] = field(default_factory=dict)
    unnamed: list[str] = field(default_factory=list)  # pictures without words
    formulas: int = 0
    unset: bool = False  # mathematics that nobody set

    @property
    def bytes(self) -> int:
        files = {unquote(urlsplit(url).path) for url in self.requests if url.startswith("file:")}
        return sum(Path(name).stat().st_size for name in files if Path(name).is_file())


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium without a network."""
    browser_file = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser_file is None:
        pytest.skip("no Chromium on this machine; on Debian: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as run:
        opened = run.chromium.launch(executable_path=browser_file, args=["--no-sandbox"])
        context = opened.new_context(offline=True)
        context.set_default_timeout(180_000)  # no test asserts a time
        yield context
        opened.close()


@pytest.fixture(scope="module")
def visits(site, parsed, browser):
    """Most pages, opened one after the other in one tab: a tab of its own takes as long again.

    Of the API, which one template makes, the longest three and those with formulas are opened.
    """
    page, made = browser.new_page(), {}
    api = sorted((site / "api").glob("*.html"), key=lambda path: path.stat().st_size)
    left_out = {path for path in api[:-3] if 'class="math' not in path.read_text()}
    page.on("request", lambda request: visit.requests.add(request.url))
    page.on("requestfailed", lambda request: visit.problems.append(request.url))
    page.on("pageerror", lambda error: visit.problems.append(str(error)))
    page.on("console", lambda said: said.type == "error" and visit.problems.append(said.text))
    for path in (path for path in parsed if path not in left_out):
        visit = made[str(path.relative_to(site))] = Visit()
        look(page, visit, path)
    page.close()
    return made


def look(page, visit, path):
    """Open a page and look at it at both widths."""
    page.set_viewport_size({"width": WIDE, "height": 900})
    page.goto(path.as_uri(), wait_until="load")
    visit.problems += page.evaluate(BROKEN)
    visit.unnamed, visit.formulas, drawn = page.evaluate(COUNTED)
    for width in (WIDE, NARROW):
        page.set_viewport_size({"width": width, "height": 900})
        if page.evaluate(OVERFLOW) > 1:
            visit.too_wide[width] = page.evaluate(TOO_WIDE)
    visit.unset = drawn != visit.formulas or page.evaluate(DOLLARS)


def told(visits, what):
    """What stands in an attribute of the visits, by page, where anything does."""
    return {name: getattr(visit, what) for name, visit in visits.items() if getattr(visit, what)}


def test_nothing_fails_and_nothing_leaves_the_disk(visits):
    assert told(visits, "problems") == {}
    asked = {url for visit in visits.values() for url in visit.requests}
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_mathematics_is_set(visits):
    assert told(visits, "formulas")  # there was some to look at
    assert told(visits, "unset") == {}


def test_no_page_is_wider_than_the_screen(visits):
    assert told(visits, "too_wide") == {}


def test_every_picture_has_words(visits):
    assert told(visits, "unnamed") == {}


def test_pages_are_light(visits):
    limits = {name: FRONT if name == "index.html" else LIGHT for name in visits}
    heavy = {
        name: f"{visit.bytes:,}" for name, visit in visits.items() if visit.bytes > limits[name]
    }
    assert heavy == {}


@pytest.mark.parametrize("number", ["5.19", "Table 5.17"])
def test_the_search_finds_a_number_and_reads_no_other_page(site, browser, number):
    page, problems = browser.new_page(), []
    page.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
    page.goto(f"{(site / 'search.html').as_uri()}?q={number.replace(' ', '+')}")
    first = page.locator("ul.search li a").first
    first.wait_for()
    first.click()
    assert page.url.split("#")[0].endswith("numbers.html")
    place = page.locator(f"[id='{page.url.partition('#')[2]}']")
    assert number in place.locator("xpath=ancestor-or-self::section[1]").locator("h3").inner_text()
    assert problems == []
