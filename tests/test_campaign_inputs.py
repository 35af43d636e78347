"""The campaign of files and modules that a user names, in small; `benchmarks/campaign.py`."""

import importlib.util
import os
import random
import signal
import sys
from pathlib import Path

import pytest

from kneexo.errors import ScenarioError
from kneexo.files.table import read_table

PATH = Path(__file__).parents[1] / "benchmarks" / "campaign_inputs.py"
spec = importlib.util.spec_from_file_location("campaign_inputs", PATH)
campaign = sys.modules["campaign_inputs"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(campaign)


def test_whole_tables_arrive_and_damaged_ones_are_refused_in_a_line(tmp_path):
    rng = random.Random(1)
    path = tmp_path / "table.csv"
    refused = []
    for _ in range(100):
        text, times, angles = campaign.csv_text(rng)
        path.write_bytes(text.encode())
        table = read_table(path, ("time_s", "knee_angle_deg"))
        assert list(table.columns.values()) == [times, angles]
        path.write_bytes(campaign.damaged_csv(text, rng))
        try:
            read_table(path, ("time_s", "knee_angle_deg"))
        except ScenarioError as error:
            refused.append(str(error))
    assert 20 < len(refused) < 100
    assert all(line.isprintable() and len(line) < campaign.LONGEST_LINE for line in refused)


@pytest.mark.parametrize(
    ("said", "code", "kind"),
    [
        ("kneexo: wrong\n", 2, "refused"),
        ("compiling\nkneexo: wrong\n", 2, "refused"),
        ("usage: kneexo\n  [--out]\nkneexo: error: wrong\n", 2, "refused"),
        ("kneexo: two\nlines\n", 2, "lines"),
        ("kneexo: \x1b[31m\n", 2, "lines"),
        (f"kneexo: {'x' * 5000}\n", 2, "lines"),
        ("", 2, "lines"),
        ("", 5, "exit code"),
        ("Traceback (most recent call last)\n", 1, "traceback"),
        ("kneexo: out of memory\n", 2, "died"),
        ("", -signal.SIGSEGV, "died"),
        ("", None, "hang"),
        ("kneexo: a warning\n", 0, "valid"),
    ],
)
def test_each_violation_is_seen(tmp_path, monkeypatch, said, code, kind):
    def run(case, folder, out, error):
        os.write(error, said.encode())
        return code

    monkeypatch.setattr(campaign, "_run_fork", run)
    assert campaign.outcome(campaign.Case("x", []), tmp_path, alone=False)[0] == kind


def test_results_are_looked_at(tmp_path, monkeypatch):
    printed = "reference: {times_s: [0.0], angles_deg: [1.0]}\n"

    def run(case, folder, out, error):
        os.write(out, printed.encode())
        (folder / "new").touch()
        return case.exit_codes[0]

    monkeypatch.setattr(campaign, "_run_fork", run)
    for case, kind in (
        (campaign.Case("x", [], samples=([0.0], [1.0]), exit_codes=(0,)), "valid"),
        (campaign.Case("x", [], samples=([0.0], [2.0]), exit_codes=(0,)), "wrong samples"),
    ):
        assert campaign.outcome(case, tmp_path, alone=False)[0] == kind
    printed = "error: NaN\n"
    assert campaign.outcome(campaign.Case("x", []), tmp_path, alone=False)[0] == "nan"


@pytest.mark.slow
def test_no_case_is_a_violation():
    outcomes = list(campaign.inputs(60, seed=2))
    assert not [outcome for outcome in outcomes if outcome[0] in campaign.BAD]
    kinds = {kind for kind, *_ in outcomes}
    assert {"csv: valid", "csv: refused", "module: refused", "folder: refused"} <= kinds
