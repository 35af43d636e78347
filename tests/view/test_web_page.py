import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import pytest

from kneexo.view.web_page import self_contained_page, web_text


class Elements(HTMLParser):
    """The elements of a page: tag, attributes and text."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.all, self._open = [], False
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.all.append([tag, dict(attributes), ""])
        self._open = True

    def handle_endtag(self, tag):
        self._open = False

    def handle_data(self, data):
        if self._open:
            self.all[-1][2] += data

    def of(self, tag):
        return [(attributes, text) for name, attributes, text in self.all if name == tag]


def policy_of(page):
    ((attributes, _),) = (m for m in Elements(page).of("meta") if "http-equiv" in m[0])
    rules = (rule.split() for rule in attributes["content"].split(";"))
    return {name: sources for name, *sources in rules}


def hash_of(text):
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


def test_the_policy_allows_the_inlined_texts_and_no_network():
    page = self_contained_page("t", "<p>b", ["p { color: red }"], ["a();", "b();\r\nc();"], {})
    policy = policy_of(page)
    scripts = [text for attributes, text in Elements(page).of("script")]
    assert scripts == ["a();", "b();\nc();"]
    assert policy["script-src"] == [hash_of(text) for text in scripts]
    assert policy["style-src"] == [hash_of("p { color: red }")]
    for rule in ("default-src", "worker-src", "base-uri", "form-action"):
        assert policy[rule] == ["'none'"]
    assert "unsafe" not in page


def test_a_worker_and_wasm_are_allowed_only_where_they_run():
    page = self_contained_page(
        "t", "", [], ["a();"], {}, worker="onmessage = 1 </script>", wasm=True
    )
    policy = policy_of(page)
    assert policy["script-src"] == [hash_of("a();"), "'wasm-unsafe-eval'"]
    assert policy["worker-src"] == ["data:"]
    (worker,) = (t for a, t in Elements(page).of("script") if a.get("id") == "worker")
    assert json.loads(worker) == "onmessage = 1 </script>"


def test_names_and_data_of_users_are_text():
    name = "</script><script>alert(1)</script><!--&amp;\u2028\udcff"
    page = self_contained_page(name, "", [], ["a();"], {"d": {"name": name, "x": [0.1, 1e-300]}})
    elements = Elements(page)
    assert len(elements.of("script")) == 2
    (data,) = (text for attributes, text in elements.of("script") if attributes)
    assert json.loads(data) == {"name": name, "x": [0.1, 1e-300]}
    assert elements.of("title")[0][1].strip() == name.replace("\udcff", "?")
    page.encode()


@pytest.mark.parametrize("text", ["x = '</SCRIPT>'", "x = '<!--'"])
def test_a_script_that_ends_its_element_is_refused(text):
    with pytest.raises(ValueError, match="must not contain"):
        self_contained_page("t", "", [], [text], {})


def test_numbers_that_json_lacks_are_refused():
    with pytest.raises(ValueError, match="JSON"):
        self_contained_page("t", "", [], [], {"d": float("nan")})


def test_a_library_comes_with_its_licence():
    for name, holder in (("three.min.js", "three.js"), ("uPlot.iife.min.js", "Leon Sorokin")):
        text = web_text(f"view/web/vendor/{name}")
        head = text[: text.index("*/")]
        assert "Permission is hereby granted" in head
        assert re.search(f"Copyright .*{holder}", head)


@pytest.mark.slow
def test_a_browser_runs_scripts_and_worker_and_nothing_else(browser, tmp_path):
    script = """
    const text = JSON.parse(document.getElementById("worker").textContent);
    const worker = new Worker(`data:text/javascript,${encodeURIComponent(text)}`);
    worker.onmessage = (event) => { window.answer = event.data; };
    worker.postMessage(JSON.parse(document.getElementById("d").textContent));
    """
    double = "onmessage = (event) => postMessage(event.data.map((x) => 2 * x));"
    style = "p { width: 123px }"
    page = tmp_path / "page.html"
    text = self_contained_page("t", "<p>x</p>", [style], [script], {"d": [1.5]}, worker=double)
    page.write_text(text, encoding="utf-8")
    browser.open(page)
    browser.wait_for("window.answer?.[0] === 3")
    assert browser.evaluate("document.querySelector('p').offsetWidth") == 123
    browser.require_health()
    evil = (
        "<p style='width: 5px' onclick='window.answer = 0'>x</p><script>window.answer = 0</script>"
    )
    page.write_text(text.replace("<p>x</p>", evil), encoding="utf-8")
    browser.open(page)
    browser.evaluate("document.querySelector('p').click()")
    browser.wait_for("window.answer?.[0] === 3")
    assert browser.evaluate("document.querySelector('p').offsetWidth") == 123
    assert any("Content Security Policy" in line for line in browser.console)
