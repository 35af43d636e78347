"""``python -m kneexo`` in a process of its own: exit codes, messages, interrupts."""

import os
import signal
import subprocess
import sys
from importlib import import_module

import kneexo.__main__ as command_line
from kneexo.command_line import main as cli


def test_python_m_kneexo_is_the_same_command():
    out = subprocess.run(
        [sys.executable, "-m", "kneexo", "--version"], capture_output=True, text=True, check=True
    )
    assert out.stdout.startswith("kneexo ")


def test_an_interrupt_after_the_command_ends_python_at_once(monkeypatch):
    monkeypatch.setattr(cli, "main", lambda: 7)
    before = signal.getsignal(signal.SIGINT)
    try:
        assert command_line.main() == 7
        assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before)


def test_modules_of_the_working_directory_are_found_after_all_others(monkeypatch, tmp_path):
    (tmp_path / "my_law_of_control.py").write_text("GAIN = 7\n")
    (tmp_path / "json.py").write_text("raise AssertionError\n")
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", os.getcwd())])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.delitem(sys.modules, "json")
    monkeypatch.chdir(tmp_path)

    def command():
        import_module("json")
        return import_module("my_law_of_control").GAIN

    monkeypatch.setattr(cli, "main", command)
    assert command_line.main() == 7
    monkeypatch.delitem(sys.modules, "my_law_of_control")
