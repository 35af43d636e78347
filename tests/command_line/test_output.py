import json
import math
import tracemalloc

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from kneexo.command_line.output import save_figure, to_json, write_csv
from kneexo.parameters import SimulationParameters
from kneexo.simulation.run import Run


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


def test_a_png_has_the_words_of_its_figure(tmp_path):
    figure, (left, right) = plt.subplots(1, 2, label="A caption.")
    figure.suptitle("above")
    left.plot([0, 1], label="curve θ")
    left.legend()
    left.set(title="(a)", xlabel="time (s)")
    right.set_ylabel("angle (deg)")
    right.set_title("(b)", loc="right")
    figure.legend(["all"])
    save_figure(tmp_path, "f", figure)
    plt.close(figure)
    with Image.open(tmp_path / "f.png") as image:
        words = image.info["Description"].split("\n")
    assert words[:2] == ["A caption.", "above"]
    assert sorted(words[2:]) == ["(a)", "(b)", "all", "angle (deg)", "curve θ", "time (s)"]


def test_a_run_is_written_with_its_time_first(tmp_path):
    data = {"angle_rad": np.array([3.0, 4.0]), "force_n": np.array([-5.0, 1.0 / 3.0])}
    write_csv(tmp_path / "run.csv", Run(np.array([0.0, 0.002]), data, SimulationParameters()))
    assert (tmp_path / "run.csv").read_text().splitlines() == [
        "time_s,angle_rad,force_n",
        "0,3,-5",
        "0.002,4,0.3333333333",
    ]


def test_a_long_run_is_written_without_a_copy_of_it(tmp_path):
    time = np.arange(20_000.0)
    run = Run(time, {f"force_{n}_n": time for n in range(4)}, SimulationParameters())
    tracemalloc.start()
    try:
        write_csv(tmp_path / "run.csv", run)
        assert tracemalloc.get_traced_memory()[1] < 0.2 * 5 * time.nbytes
    finally:
        tracemalloc.stop()
    assert np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1).shape == (20_000, 5)
