"""The page to play with in a notebook."""

import html
import re
from contextlib import contextmanager

import pytest

import kneexo as kx
from kneexo.errors import OutputError, ParameterError
from kneexo.page import play as module
from kneexo.parameters.scenario_file import dump_scenario


@pytest.fixture
def made(monkeypatch):
    """The arguments of each page that is made; the page itself is a short text."""
    calls = []

    def page(scenarios, names):
        calls.append((list(scenarios), tuple(names)))
        return f'<p title="a">&amp; "{names[0]}"</p>'

    monkeypatch.setattr(module, "playground_page", page)
    return calls


def test_scenarios_files_and_names(made, tmp_path):
    pid = kx.Scenario().changed({"controller": "pid"})
    path = tmp_path / "mine.yaml"
    path.write_text(dump_scenario(pid), encoding="utf-8")
    leg = kx.Scenario.preset("leg")
    assert kx.play().names == ("preset paper",)
    assert kx.play(leg, path, str(path), pid).names == ("preset leg", "mine", "mine", "scenario 4")
    assert kx.play(pid, path, names=["mine", "other"]).names == ("mine", "other")
    assert made[0][0] == [kx.Scenario()]
    assert made[1][0] == [leg, pid, pid, pid]
    assert made[2] == ([pid, pid], ("mine", "other"))


def test_wrong_names_are_refused(made):
    with pytest.raises(ParameterError, match="names: 1 names for 2 scenarios; must be one for"):
        kx.play(kx.Scenario(), kx.Scenario(), names=["mine"])
    with pytest.raises(ParameterError, match="must be an object of Scenario, such as"):
        kx.play(3)
    assert made == []


def test_a_cell_has_the_page_in_a_frame(made):
    page = kx.play(kx.Scenario(), names=['"><script>'])
    cell = page._repr_html_()
    (source,) = re.findall(r'^<iframe srcdoc="([^"]*)" title="[^"<>]*" [^<>]*></iframe>$', cell)
    assert html.unescape(source) == page.html
    assert 'sandbox="allow-scripts allow-downloads"' in cell
    assert "<p" not in repr(page)


def test_a_page_is_written_and_replaced_and_has_its_suffix(made, tmp_path):
    page = kx.play()
    path = page.write(tmp_path / "new" / "knee.html")
    assert path.read_text("utf-8") == page.html
    assert page.write(str(path)) == path
    with pytest.raises(OutputError, match=r"must end in \.html"):
        page.write(tmp_path / "a.txt")
    assert not (tmp_path / "a.txt").exists()


def test_the_browser_opens_a_file_with_the_page(made, monkeypatch, tmp_path):
    monkeypatch.setattr(module.tempfile, "tempdir", str(tmp_path))
    addresses = []
    monkeypatch.setattr(module.webbrowser, "open", lambda url: not addresses.append(url))
    page = kx.play()
    path = page.open()
    assert addresses == [path.as_uri()]
    assert path.read_text("utf-8") == page.html
    monkeypatch.setattr(module.webbrowser, "open", lambda url: False)
    with pytest.raises(OutputError, match=r"no browser here; .*\.html has the page, open it"):
        page.open()


NOTEBOOKS = {
    "jupyterlab": "",
    # The policy of a cell in VS Code, which the frame inherits.
    "vs_code": (
        "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
        "img-src https: http: data:; font-src https:; connect-src https:; child-src https: data:"
    ),
}


def frames(browser):
    """The identifiers of the frames that have processes of their own."""
    targets = browser.call("Target.getTargets")["targetInfos"]
    return [target["targetId"] for target in targets if target["type"] == "iframe"]


@contextmanager
def frame_in(browser, file, **size):
    """Open a page; the calls of the browser reach its frame, which has a process of its own."""
    browser.load(url="about:blank")
    browser.wait_for(lambda: not frames(browser))  # of the page before
    browser.open(file, **size)
    browser.wait_for(lambda: frames(browser))
    (frame,) = frames(browser)
    outer = browser._session
    attached = browser.call("Target.attachToTarget", targetId=frame, flatten=True)
    browser._session = attached["sessionId"]
    try:
        for domain in ("Runtime", "Log", "Network"):
            browser.call(f"{domain}.enable")
        browser.picture()  # once a frame showed nothing for 30 s; a picture makes Chromium draw
        yield
    finally:
        browser._session = outer


@pytest.fixture(scope="module")
def cell():
    return kx.play(kx.Scenario())._repr_html_()


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS)
def test_the_page_runs_in_the_cell_of_a_notebook(notebook, cell, browser, tmp_path):
    outer = tmp_path / "notebook.html"
    policy = NOTEBOOKS[notebook]
    meta = f'<meta http-equiv="Content-Security-Policy" content="{policy}">' if policy else ""
    outer.write_text(f"<!doctype html>{meta}{cell}", encoding="utf-8")
    numbers = "document.querySelector('#numbers')?.innerText"
    with frame_in(browser, outer, width=1000, height=950):
        browser.wait_for(rf"/Largest error\s+[\d.]+\s+deg\s+follows/i.test({numbers})")
        shown = browser.evaluate(numbers)
    (error_deg,) = re.findall(r"(?i)largest error\s+([\d.]+)", shown)
    expected = kx.track(kx.Scenario()).metrics.max_error_deg
    assert float(error_deg) == pytest.approx(expected, abs=0.51e-3)  # three decimals
    assert browser.console == []


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1010, 768), (358, 416)])
def test_a_frame_shows_a_curve_and_a_slider_at_once(width, height, cell, browser, tmp_path):
    outer = tmp_path / "outer.html"
    style = "<style>body { margin: 0; } iframe { display: block; }</style>"
    frame = cell.replace('height="900"', f'height="{height}"')
    outer.write_text(f"<!doctype html>{style}{frame}", encoding="utf-8")
    ready = "document.body?.classList.contains('framed') && Page.results[0].fresh"
    boxes = """["#plots .plot:not([hidden]) canvas", "#panel input[type=range]"].map((name) => {
      const box = [...document.querySelectorAll(name)].find((one) => one.checkVisibility())
        .getBoundingClientRect();
      return [box.top, box.bottom]; })"""
    with frame_in(browser, outer, width=width, height=height):
        browser.wait_for(ready)
        places = browser.evaluate(boxes)
        assert browser.evaluate("document.getElementById('undo').checkVisibility()") is False
    for top, bottom in places:
        assert 0.0 <= top < bottom <= height
