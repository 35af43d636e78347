"""The worker of a page under Node, and in Chromium."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from kneexo.view.web_page import web_text

FILES = (
    "page/web/simulator.js",
    "page/web/linear_loop.js",
    "page/web/sine_sweep.js",
    "page/web/worker.js",
)


def _numbers(value):
    """Numbers in place of the texts that stand for them."""
    names = {"Infinity": float("inf"), "-Infinity": -float("inf"), "NaN": float("nan")}
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list) and not all(isinstance(item, float | int) for item in value):
        return [_numbers(item) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


class _Worker:
    """A process of Node with the worker of a page."""

    def __init__(self, file):
        command = ["node", str(Path(__file__).with_name("under_node.js")), str(file)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = subprocess.Popen(command, **pipes, text=True, encoding="utf-8")
        self._count = 0

    def send(self, **request):
        """Send a request and return its number."""
        self._count += 1
        self._process.stdin.write(json.dumps({"id": self._count, **request}) + "\n")
        self._process.stdin.flush()
        return self._count

    def receive(self):
        """The next answer."""
        line = self._process.stdout.readline()
        assert line, "Node has ended"
        return _numbers(json.loads(line))

    def ask(self, **request):
        """The answer to a request, with the points of a sweep and the parts of a run before it."""
        number, points, parts = self.send(**request), [], []
        while (answer := self.receive())["id"] != number or {"point", "unfinished"} & set(answer):
            if "point" in answer:
                points.append(answer["point"])
            else:
                parts.append(answer)
        return answer | {"points": points, "parts": parts}

    def evaluate(self, script):
        """The value of an expression; promises are awaited."""
        return self.ask(script=script)["value"]

    def close(self):
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@pytest.fixture(scope="session")
def worker_text():
    """The script of the worker."""
    return "\n".join(map(web_text, FILES))


@pytest.fixture(scope="session")
def worker(tmp_path_factory, worker_text):
    """A `_Worker`; skips without Node."""
    if shutil.which("node") is None:
        pytest.skip("needs node")
    file = tmp_path_factory.mktemp("worker") / "worker.js"
    file.write_text(worker_text, encoding="utf-8")
    worker = _Worker(file)
    yield worker
    worker.close()
