import json
import math

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.errors import OutputError
from kneexo.output import output_directory, save_figure, to_json


def test_files_appear_when_the_body_ends(tmp_path):
    target = tmp_path / "a" / "b"
    with output_directory(target) as directory:
        (directory / "x.txt").write_text("1")
        assert not (target / "x.txt").exists()
    assert [file.name for file in target.iterdir()] == ["x.txt"]


def write_and_fail(target, text, error):
    with output_directory(target) as directory:
        (directory / "x.txt").write_text(text)
        raise error


def test_nothing_is_left_when_the_body_fails(tmp_path):
    target = tmp_path / "out"
    with pytest.raises(ZeroDivisionError):
        write_and_fail(target, "half", ZeroDivisionError())
    assert not target.exists()


def test_old_files_survive_a_failure(tmp_path):
    (tmp_path / "x.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_and_fail(tmp_path, "new", KeyboardInterrupt())
    assert [file.name for file in tmp_path.iterdir()] == ["x.txt"]
    assert (tmp_path / "x.txt").read_text() == "old"


@pytest.mark.parametrize("where", ["file", "file/below", "/proc/kneexo"])
def test_an_unwritable_directory_is_refused_before_the_body(tmp_path, where):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write there") as caught:
        write_and_fail(tmp_path / where, "", AssertionError("the body was entered"))
    assert "\n" not in str(caught.value)


def test_a_failing_write_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="No space"), output_directory(tmp_path / "out"):
        raise OSError(28, "No space left on device")
    assert not (tmp_path / "out").exists()


def test_json_has_plain_numbers_and_null_for_nan():
    text = to_json({"a": np.arange(2), "b": (math.nan, np.float64(1.5)), "c": {"d": "µ"}})
    assert json.loads(text) == {"a": [0, 1], "b": [None, 1.5], "c": {"d": "µ"}}


def test_equal_figures_are_equal_files(tmp_path):
    for name in "ab":
        figure, ax = plt.subplots()
        ax.plot([0, 1])
        (tmp_path / name).mkdir()
        save_figure(tmp_path / name, "f", figure)
        plt.close(figure)
    for kind in ("png", "pdf"):
        first, second = ((tmp_path / name / f"f.{kind}").read_bytes() for name in "ab")
        assert first == second
