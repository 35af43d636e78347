"""Shared: the four-bar linkage by compass and ruler; tables and lines as they are printed; pages in
Chromium.
"""

import base64
import gc
import io
import json
import math
import os
import re
import resource
import select
import shlex
import shutil
import signal
import subprocess
import sys
import zipfile
from contextlib import suppress
from decimal import Decimal, InvalidOperation
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

# As in sweeps: workers of pytest have a core each, and threads of BLAS would only wait for it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
os.environ.pop("COLUMNS", None)  # a worker of pytest-xdist has 80

import hypothesis
import msgpack
import numpy as np
import pydrake.common.cpp_template
import pytest
from waiting import LOOK_S, wait_for

from diagramc.native.cache import cache_directory
from kneexo.command_line import parser

# The tests start dozens of Pythons: none translates every module anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A shell starts `pytest &` with Ctrl-C ignored, and so would every command that a test interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)


def _module_of_caller(frame=2):
    """Return the module whose code runs ``frame`` calls above, as `inspect.stack` would find it."""
    return sys.modules[sys._getframe(frame).f_globals["__name__"]]


# Drake asks at each first instantiation of a system; reading all files of the stack takes 20 ms.
pydrake.common.cpp_template._get_module_from_stack = _module_of_caller


def pytest_configure(config):
    """Compile models of fast tests at LLVM's level 0, because most of them run once.

    A property of a fast test is tried with 25 examples, the same in each run, so that no draw fails
    a change that did not touch it. With ``KNEEXO_NEW_EXAMPLES=1`` ten times as many are drawn anew,
    but as many as before where a test has a number of its own.
    """
    fast = config.option.markexpr.endswith("not slow")
    new = bool(os.environ.get("KNEEXO_NEW_EXAMPLES"))
    os.environ.setdefault("DIAGRAMC_LLVM_LEVEL", "0" if fast else "3")
    hypothesis.settings.register_profile(
        "kneexo",
        max_examples=(25 if fast else 100) * (10 if new else 1),
        derandomize=not new,
        print_blob=new,
        # A loaded machine fails no test.
        deadline=None,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )
    hypothesis.settings.load_profile("kneexo")


MOST_CPU_S = 0.2
"""Largest processor time in s of a fast test, with the processes that the test starts."""


def _cpu_s():
    """Return the processor time in s of this process and of its ended child processes."""
    times = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(time.ru_utime + time.ru_stime for time in times)


STOP_CPU_S = {"fast": 60.0, "slow": 900.0}
"""Processor time in s after which a test is stopped, against a loop that does not end.

It is that of the process of the tests. `timeout` in pyproject.toml, in wall time, is the stop of a
test that waits for ever; no load of the machine makes a test last so long.
"""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Measure the processor time of a fast test; fail if it exceeds ``--cpu-limit``."""
    slow = item.get_closest_marker("slow")
    start_s, limit_s = _cpu_s(), item.config.option.cpu_limit
    stop_s = STOP_CPU_S["slow" if slow else "fast"]

    def stop(number, frame):
        pytest.fail(f"stopped after {stop_s:g} s of processor time, as if it did not end")

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, stop_s)
    try:
        result = yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if not slow:
        time_s = _cpu_s() - start_s
        item.user_properties.append(("cpu_s", time_s))
        if time_s > limit_s:
            pytest.fail(f"takes {time_s:.2f} s of processor time, more than {limit_s:g} s")
    return result


def pytest_addoption(parser):
    """Add the option that holds the rule of CONTRIBUTING on the time of fast tests."""
    parser.addoption(
        "--cpu-limit",
        type=float,
        default=math.inf,
        metavar="S",
        help="fail if a fast test takes more than S seconds of processor time",
    )


def pytest_terminal_summary(terminalreporter, config):
    """List the fast tests that take more than `MOST_CPU_S`, the slowest one first."""
    times_s = {
        report.nodeid: dict(report.user_properties).get("cpu_s", 0.0)
        for report in terminalreporter.getreports("passed")
    }
    slow = sorted((t for t in times_s.items() if t[1] > MOST_CPU_S), key=lambda t: -t[1])
    if slow:
        terminalreporter.section(f"{len(slow)} fast tests take more than {MOST_CPU_S} s CPU")
    for name, time_s in slow[:10]:
        terminalreporter.line(f"{time_s:5.2f} s  {name}")


@pytest.hookimpl(tryfirst=True)  # before pytest selects by `-m`
def pytest_collection_modifyitems(items):
    """Mark the slow tests of the gate: all of pages, and some cases of each other test."""
    cases = {}
    for item in items:
        if item.get_closest_marker("slow"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for several in cases.values():
        size, page = len(several), "browser" in several[0].fixturenames
        count = several[0].get_closest_marker("slow").kwargs.get("gate", size if page else 1)
        for k in range(count):  # at even distances
            several[k * size // count].add_marker("browser" if page else "gate")


# -------------------------------------------------------------------------------- missing tools

ALLOWED_SKIPS = {
    "root may write everywhere": "a test of a folder that refuses, where root runs the tests",
    "this machine is no ": "code of the kinds of processors that this machine does not have",
    "this processor has no AVX2": "as before",
    "needs an x86-64 processor": "as before",
    "code for x86-64": "as before",
    "needs Zig": "binaries for other machines and modules, by the extra `cross`: in .ci/full",
    "could not import 'numba'": "a peer of the extra `peers`, for benchmarks alone",
    "could not import 'heyoka'": "as before",
}
"""Reasons, or their beginnings, for which a test may be skipped where ``KNEEXO_CI`` is set."""


def _require(report):
    """Let a skip for a missing tool fail in CI, so that no hole of the tests is silent."""
    if os.environ.get("KNEEXO_CI") and report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        if not reason.startswith(tuple(ALLOWED_SKIPS)):
            report.outcome, report.longrepr = "failed", f"missing in CI: {reason}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    return _require((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    return _require((yield))


def pytest_collection_finish():
    """Leave modules and tests, which stay to the end, out of the searches for garbage.

    The searches are rarer than by default, because they would take a tenth of the time.
    """
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


def pytest_sessionfinish():
    """Leave everything out of the search for garbage with which pytest ends."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _compilers_remember(tmp_path_factory):
    """C compilers on the PATH keep what they made beside the compiled models."""
    script = Path(__file__).with_name("remembering_compiler.py")
    folder = tmp_path_factory.mktemp("compilers")
    store = cache_directory() / "compilers"
    try:
        store.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:  # they compile each time
        yield
        return
    for name in ("cc", "gcc", "g++", "clang", "arm-none-eabi-gcc"):
        if compiler := shutil.which(name):
            line = shlex.join([sys.executable, "-IS", str(script), str(store), compiler])
            (folder / name).write_text(f'#!/bin/sh\nexec {line} "$@"\n', encoding="utf-8")
            (folder / name).chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(folder), prepend=os.pathsep)
        yield


def _walk(link, theta_4):
    """Assemble along a path of θ_4 (rad) that starts at the extended knee.

    Joint A is where the circle of link 2 about O_A meets that of the coupler about B; of the two
    intersections the one whose knee angle starts nearest to zero is kept all along.
    """
    theta_4 = np.asarray(theta_4, dtype=float)
    o_a = link.o_a_x_m + 1j * link.o_a_y_m
    o_b = link.o_b_x_m + 1j * link.o_b_y_m
    b = o_b + link.a_4_m * np.exp(1j * theta_4)
    distance = np.abs(b - o_a)
    along = (link.a_2_m**2 - link.a_3_m**2 + distance**2) / (2.0 * distance)
    across = np.sqrt(link.a_2_m**2 - along**2)
    walks = []
    for side in (1j, -1j):
        a = o_a + (b - o_a) / distance * (along + side * across)
        theta_3 = np.unwrap(np.angle(b - a))
        knee = theta_3 + link.phi_rad
        knee = knee - 2.0 * np.pi * np.round(knee.flat[0] / (2.0 * np.pi))
        pin = b + link.rod_pin_radius_m * np.exp(1j * (theta_3 + link.rod_pin_angle_rad))
        anchor = link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad)
        walks.append(
            SimpleNamespace(
                theta_4=theta_4,
                theta_3=theta_3,
                knee_angle=knee,
                joint_a=a,
                joint_b=b,
                rod_pin=pin,
                rod_extension=np.abs(pin - anchor) - link.rod_length_m,
            )
        )
    return min(walks, key=lambda walk: abs(walk.knee_angle.flat[0]))


@pytest.fixture(scope="session")
def compass():
    """The function ``compass(link, theta_4)``: joints, knee angle and rod along a path."""
    return _walk


def _meshcat_commands(page):
    """What a page of Meshcat tells its viewer: messages in MessagePack, in base64."""
    messages = []
    for text in re.findall(r"base64,([A-Za-z0-9+/=]+)", page):
        with suppress(ValueError):  # the viewer's own files are no messages
            message = msgpack.unpackb(base64.b64decode(text))
            messages += [message] if isinstance(message, dict) and "type" in message else []
    return messages


@pytest.fixture(scope="session")
def commands():
    """The function ``commands(page)``: what a page of Meshcat tells its viewer, one after another.

    Such as ``{"type": "set_property", "path": …, "property": …, "value": …}``.
    """
    return _meshcat_commands


def _tables(text):
    """Each Markdown table of a text as rows of cells, the head first."""
    found, inside = [], False
    for line in text.splitlines():
        if not line.startswith("|"):
            inside = False
            continue
        cells = [cell.strip() for cell in line[1:-1].replace(r"\|", "¦").split("|")]
        if not inside:
            found.append([])
        if not all(set(cell) <= {"-"} and cell for cell in cells):
            found[-1].append(cells)
        inside = True
    for table in found:
        assert {len(row) for row in table} == {len(table[0])}, table[0]
    return found


@pytest.fixture(scope="session")
def tables():
    """The function ``tables(text)``: the cells of each Markdown table, its head as first row."""
    return _tables


def _says(cell, value):
    """Whether a cell shows a number, to its digits; a zero after three digits is none."""
    if not math.isfinite(value):
        return cell == ("–" if math.isnan(value) else "∞" if value > 0.0 else "−∞")
    try:
        shown = Decimal(cell)
    except InvalidOperation:
        return False
    integer = cell.lstrip("+-")
    zeros = min(len(integer) - len(integer.rstrip("0")), len(integer) - 3)
    exponent = zeros if integer.isdigit() and zeros > 0 else shown.as_tuple().exponent
    return abs(float(shown) - value) <= 0.5001 * 10.0**exponent


@pytest.fixture(scope="session")
def check_cells():
    """The function ``check_cells(table, rows)``: rows of text and numbers, without the head.

    A row may give its values by the titles of their columns, which are then checked too.
    """

    def check(table, rows):
        assert len(table) - 1 == len(rows)
        for cells, expected in zip(table[1:], rows, strict=True):
            if isinstance(expected, dict):
                assert table[0] == list(expected)
                expected = expected.values()
            for title, cell, value in zip(table[0], cells, expected, strict=True):
                good = cell == value if isinstance(value, str) else _says(cell, value)
                assert good, f"{cells[0]}, {title}: {cell!r} is not {value!r}"

    return check


def _flat(value, path=""):
    """Every leaf of nested data by its path; arrays and numbers as plain ones."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = enumerate(value)
    else:
        return {path: value}
    return {k: v for key, item in items for k, v in _flat(item, f"{path}/{key}").items()}


@pytest.fixture(scope="session")
def flat():
    """The function ``flat(data)``: leaves of nested data by path, which pytest.approx compares."""
    return _flat


@pytest.fixture(scope="session")
def curves():
    """The function ``curves(ax)``: the data (x, y) of each line that the legend names."""

    def read(ax):
        named = [line for line in ax.lines if not line.get_label().startswith("_")]
        assert len({line.get_label() for line in named}) == len(named)
        return {
            line.get_label(): tuple(np.asarray(v, dtype=float) for v in line.get_data())
            for line in named
        }

    return read


@pytest.fixture(scope="module")
def parser_once():
    """Build the parser of the command line, which takes longer than most answers, once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parser, "_parser", cache(parser._parser))
        yield


@pytest.fixture(autouse=True)
def _no_figure_stays_open():
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


# ---------------------------------------------------------------------------------- browser

CHROMIUM = shutil.which("chromium")


class _Browser:
    """Chromium without a window, by its DevTools protocol over pipes: one page at a time."""

    def __init__(self, profile):
        options = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage"]
        options += [
            "--disable-features=BackForwardCache",  # a page that is left ends with its frames
            # As Playwright does: a page or frame that Chromium takes for hidden waits for no test.
            "--disable-backgrounding-occluded-windows",
            "--disable-renderer-backgrounding",
            "--disable-background-timer-throttling",
            "--enable-unsafe-swiftshader",
            "--remote-debugging-pipe",
            f"--user-data-dir={profile}",
        ]
        to_chromium, self._out = os.pipe()
        self._in, from_chromium = os.pipe()

        def hand_over():  # Chromium reads from 3 and writes to 4
            ends = os.dup(to_chromium), os.dup(from_chromium)
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self._process = subprocess.Popen(
            [CHROMIUM, *options],
            preexec_fn=hand_over,
            pass_fds=(3, 4),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_chromium)
        os.close(from_chromium)
        self._received, self._count = b"", 0
        self._page = self._session = None  # that of a frame, while its test runs
        self._folder, self._loaded = profile, False
        self.console = []
        """Lines that tell of a fault: level or exception, and text."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._page = self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """The result of a command of the protocol; events until then are heard."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if session := self._page if method.startswith("Page.") else self._session:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._count:
            pass
        assert "error" not in answer, answer
        return answer["result"]

    def _next(self):
        while b"\0" not in self._received:
            wait_for(lambda: select.select([self._in], [], [], LOOK_S)[0])
            piece = os.read(self._in, 1 << 20)
            assert piece, "Chromium has ended"
            self._received += piece
        text, _, self._received = self._received.partition(b"\0")
        message = json.loads(text)
        self._hear(message.get("method"), message.get("params", {}))
        return message

    def _hear(self, event, told):
        if event == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.console.append(f"exception: {details.get('exception', details)}")
        elif event == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.console.append(f"console: {told['args']}")
        elif event == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.console.append(f"log: {told['entry']['text']}")
        elif event == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])
        elif event == "Page.loadEventFired":
            self._loaded = True

    def load(self, method="Page.navigate", **parameters):
        """Load a document by a command of the protocol, and wait until it is complete.

        The state of a document would not tell, because the document before is complete too.
        """
        self._loaded = False
        self.call(method, **parameters)
        while not self._loaded:
            self._next()

    def open(self, path, width=800, height=600, phone=False, script="", **wishes):
        """Load a file in a window of that size in CSS pixels; ``phone``: as a phone would.

        ``script`` runs before those of the page. ``wishes`` of the user are as in `emulate`: no
        page plays by itself if no test asks for motion.
        """
        self.console, self.requests, self._width = [], [], width
        scale = 2 if phone else 1
        size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": phone}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.emulate(**wishes)
        # Of 50 entries Chromium drops the first that a script has left, which may be this page's.
        self.call("Page.resetNavigationHistory")
        before = self.call("Page.addScriptToEvaluateOnNewDocument", source=script)
        self.load(url=path.resolve().as_uri())
        self.call("Page.removeScriptToEvaluateOnNewDocument", **before)

    def emulate(self, motion=False, scheme="", media=""):
        """What a user wishes: motion, a light or dark scheme, print as medium.

        A page that plays takes a whole core to draw, which the tests beside it lack.
        """
        wishes = {"reduced-motion": "" if motion else "reduce", "color-scheme": scheme}
        features = [{"name": f"prefers-{name}", "value": value} for name, value in wishes.items()]
        self.call("Emulation.setEmulatedMedia", media=media, features=features)

    def evaluate(self, script):
        """The value of an expression in the page; promises are awaited."""
        options = {"returnByValue": True, "awaitPromise": True}
        answer = self.call("Runtime.evaluate", expression=script, **options)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, condition):
        """Wait until an expression in the page, or a function of Python, is true."""
        test = condition if callable(condition) else partial(self.evaluate, condition)
        try:
            wait_for(test)
        except TimeoutError as error:
            shown = self.evaluate("[location.href, document.body?.innerText?.slice(0, 500)]")
            picture = self._folder / "never_true.png"
            picture.write_bytes(self._screenshot())
            load = f"load {os.getloadavg()[0]:.1f}, {error}"
            pytest.fail(f"never true: {condition}; {self.console}; {shown}; {load}; see {picture}")

    def require_health(self):
        """The page and its frames have told of no fault and asked for nothing outside the file."""
        assert self.console == []
        assert [url for url in self.requests[1:] if not url.startswith(("data:", "blob:"))] == []

    def require_width(self):
        """No part of the page lies beyond the right edge of the window."""
        assert self.evaluate("document.documentElement.scrollWidth") <= self._width

    def views_of_playing(self, window="window"):
        """Pictures of a view 1 s and 4 s after its start, in a window of the page, as it plays."""
        self.wait_for(f"{window}?.stage?.time > 0.1")
        pictures = []
        for second in (1, 4):
            script = """(async (window) => {
              window.stage.pause();
              window.stage.seek(%d);
              for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
            })(%s)"""
            self.evaluate(script % (second, window))
            pictures.append(self.picture())
        return pictures

    def picture(self):
        """What the window shows, (rows, columns, 3) from 0 to 1."""
        from matplotlib.image import imread

        return imread(io.BytesIO(self._screenshot()))[..., :3]

    def _screenshot(self):
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self):
        os.close(self._out)  # Chromium ends with its pipe
        self._process.wait()
        os.close(self._in)


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A `_Browser`; skips without Chromium."""
    if CHROMIUM is None:
        pytest.skip("needs the browser chromium")
    browser = _Browser(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """The contents of the wheel of this repository, unpacked elsewhere."""
    folder = tmp_path_factory.mktemp("wheel")
    root, source = Path(__file__).parents[1], folder / "source"
    for package in ("diagramc", "kneexo"):
        shutil.copytree(root / package, source / package, ignore=shutil.ignore_patterns("__py*"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / name, source / name)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-index"]  # setuptools is in the extra dev
    built = subprocess.run(
        [*pip, "--no-build-isolation", "--no-deps", "-w", str(folder), str(source)],
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    (file,) = folder.glob("kneexo-*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "site")
    return folder / "site"
