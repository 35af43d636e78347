"""Errors of a user's code."""

import io
import json
import os
import sys
from pathlib import Path

import pytest

from kneexo.common.user_code import cause_of, place_in_user_code, user_code
from kneexo.errors import LinkageError, ParameterError


class UnspeakableError(Exception):
    def __str__(self):
        raise ValueError


def caught(function):
    try:
        function()
    except Exception as error:
        return error
    raise AssertionError


def test_the_place_is_that_of_the_innermost_frame_of_the_user():
    error = caught(lambda: json.loads("["))
    file, line = place_in_user_code(error)
    assert (file, line) == (__file__, error.__traceback__.tb_next.tb_lineno)
    message = (
        f"JSONDecodeError: Expecting value: line 1 column 2 (char 1) ({__file__}, line {line})"
    )
    assert cause_of(error) == message


def test_any_error_has_a_cause_of_one_line():
    def fail():
        raise UnspeakableError

    assert cause_of(caught(fail)).startswith("UnspeakableError: <exception str() failed> (")
    assert cause_of(ValueError("two\nlines")) == "ValueError: two"
    assert cause_of(KeyError()) == "KeyError"
    assert cause_of(SystemExit(5)) == "SystemExit: 5"
    noted = ValueError("x")
    noted.add_note("more")
    assert cause_of(noted) == "ValueError: x"
    syntax = caught(lambda: compile("x = (", "mine.py", "exec"))
    assert cause_of(syntax) == "SyntaxError: '(' was never closed (mine.py, line 1)"


@pytest.mark.parametrize("error", [SystemExit(0), GeneratorExit(), RecursionError("deep")])
def test_every_error_becomes_one_of_ours(error):
    message = f"^it fails: {type(error).__name__}"
    with pytest.raises(ParameterError, match=message) as info, user_code("it fails"):
        raise error
    assert info.value.__cause__ is error


def test_what_the_code_changes_of_python_is_restored_or_an_error(monkeypatch, tmp_path):
    limit, directory = sys.getrecursionlimit(), Path.cwd()
    with user_code("it fails"):
        sys.setrecursionlimit(limit + 7)
        os.chdir(tmp_path)
    assert (sys.getrecursionlimit(), Path.cwd()) == (limit, directory)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    with pytest.raises(ParameterError, match=r"the code closes sys\.stdout"), user_code("it fails"):
        sys.stdout.close()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), LinkageError("ours")])
def test_interrupts_and_our_errors_pass(error):
    with pytest.raises(type(error)) as info, user_code("it fails"):
        raise error
    assert info.value is error
