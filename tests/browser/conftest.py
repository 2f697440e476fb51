"""A real browser: headless Chromium, with everything that a page says and asks for written down."""

import shutil
from contextlib import contextmanager

import pytest
from processes import HUNG

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--no-first-run",
)


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium; the test is skipped where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)}")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=FLAGS, timeout=1000 * HUNG)
        yield chromium
        chromium.close()


@pytest.fixture
def new_page(browser):
    """Return a function (options) -> page, whose waits do not end because the machine is busy."""

    def make(**options):
        page = browser.new_page(**options)
        page.set_default_timeout(1000 * HUNG)
        return page

    return make


@pytest.fixture
def open_page(new_page):
    """Return a context manager (url, width, height, light or dark) -> page."""

    @contextmanager
    def open_(url: str, width: int = 600, height: int = 450, scheme: str = "light"):
        page = new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        errors, requests = [], []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("dialog", lambda dialog: (errors.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda request: requests.append(request.url))
        try:
            page.goto(str(url))
            yield page
        finally:
            page.close()
        assert errors == []
        here = (str(url), "data:", "blob:", "about:", "http://localhost:", "ws://localhost:")
        assert [url for url in requests if not url.startswith(here)] == []

    return open_
