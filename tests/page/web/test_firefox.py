"""The page to play with in Firefox: the same numbers as in Chromium, by real keys and clicks."""

import json
import select
import shutil
import socket
import subprocess

import pytest
from waiting import LOOK_S, wait_for

from kneexo.analysis import track
from kneexo.page.playground import playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario

pytestmark = pytest.mark.slow(gate=0)

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")


class _Firefox:
    """Firefox without a window, by its protocol Marionette: texts of JSON behind their length."""

    def __init__(self, profile):
        profile.mkdir()
        (profile / "user.js").write_text('user_pref("marionette.port", 0);\n', "utf-8")
        command = [FIREFOX, "--headless", "--marionette", "--no-remote", "--profile", str(profile)]
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(command, **pipes)
        self._received, self._count = b"", 0
        chosen = profile / "MarionetteActivePort"
        wait_for(lambda: chosen.exists() and chosen.read_text())
        self._socket = socket.create_connection(("127.0.0.1", int(chosen.read_text())))
        self._next()  # the greeting
        self.call("WebDriver:NewSession")

    def _next(self):
        while b":" not in self._received:
            self._receive()
        length, _, self._received = self._received.partition(b":")
        while len(self._received) < int(length):
            self._receive()
        text, self._received = self._received[: int(length)], self._received[int(length) :]
        return json.loads(text)

    def _receive(self):
        wait_for(lambda: select.select([self._socket], [], [], LOOK_S)[0])
        piece = self._socket.recv(1 << 16)
        assert piece, "Firefox has ended"
        self._received += piece

    def call(self, command, **parameters):
        """The result of a command of the protocol."""
        self._count += 1
        text = json.dumps([0, self._count, command, parameters])
        self._socket.sendall(f"{len(text.encode())}:{text}".encode())
        _, _, error, result = self._next()
        assert error is None, error
        return result

    def evaluate(self, expression):
        """The value of an expression, which sees the document and nothing of the page's scripts."""
        return self.call("WebDriver:ExecuteScript", script=f"return {expression}", args=[])["value"]

    def wait_for(self, condition):
        """Wait until an expression in the page is true."""
        try:
            wait_for(lambda: self.evaluate(condition))
        except TimeoutError as error:
            pytest.fail(f"never true: {condition}; {error}")

    def find(self, selector):
        """The element of a selector."""
        result = self.call("WebDriver:FindElement", using="css selector", value=selector)
        return next(iter(result["value"].values()))

    def close(self):
        self.call("Marionette:Quit", flags=["eForceQuit"])
        self._process.wait()
        self._socket.close()


@pytest.fixture(scope="module")
def firefox(tmp_path_factory):
    if FIREFOX is None:
        pytest.skip("needs the browser firefox-esr")
    firefox = _Firefox(tmp_path_factory.mktemp("firefox") / "profile")
    yield firefox
    firefox.close()


LAMBDA = "q-controller.lambda_per_s"
READY = """[...document.querySelectorAll(".card:not([hidden])")].length === 6
  && ![...document.querySelectorAll(".word")].some((word) => word.textContent === "computing")"""
ERROR = "document.querySelector('[data-number=error] .number').textContent"


def test_a_key_on_a_slider_gives_the_numbers_of_kneexo(firefox, tmp_path):
    page = tmp_path / "page.html"
    page.write_text(playground_page([Scenario()], ["paper"]), encoding="utf-8")
    firefox.call("WebDriver:SetWindowRect", width=1440, height=900)
    firefox.call("WebDriver:Navigate", url=page.as_uri())
    firefox.wait_for(READY)
    before = firefox.evaluate(ERROR)
    slider = firefox.find(f"[id='{LAMBDA}']")
    firefox.call("WebDriver:ElementSendKeys", id=slider, text=5 * "\ue012")  # to the left
    firefox.wait_for(f"{ERROR} !== '{before}' && {READY}")
    firefox.call("WebDriver:ElementClick", id=firefox.find("#copy-yaml"))
    file = tmp_path / "page.yaml"
    file.write_text(firefox.evaluate("document.getElementById('text-area').value"), "utf-8")
    firefox.call("WebDriver:ElementClick", id=firefox.find("#text-dialog .primary"))
    scenario = load_scenario(file)
    assert scenario.controller.lambda_per_s < Scenario().controller.lambda_per_s
    error_deg = track(scenario).metrics.max_error_deg
    firefox.wait_for(f"Math.abs({ERROR} - {error_deg}) <= 6e-3 * {error_deg}")
    assert firefox.evaluate("document.getElementById('notice').hidden")
    assert firefox.evaluate("document.documentElement.scrollWidth <= innerWidth")
    firefox.call("WebDriver:ElementClick", id=firefox.find("#compare"))
    names = "[...document.querySelectorAll('.stage-leg .name')].map((e) => e.textContent)"
    firefox.wait_for(f"{names}.join() === 'A: sliding mode,B: PID'")
    firefox.wait_for(
        "document.querySelectorAll('[data-number=error] .value:not([hidden])').length === 2"
    )
