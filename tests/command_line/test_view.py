import os

from kneexo.command_line.main import main


def test_a_file_name_may_have_bytes_that_are_no_text(tmp_path, capsys):
    scenario = tmp_path / os.fsdecode(b"knee\xff.yaml")
    scenario.write_text("simulation: {duration_s: 0.1}\n")
    page = tmp_path / "knee.html"
    assert main(["view", str(scenario), "--out", str(page)]) == 0
    text = page.read_text()
    assert "<title>kneexo: knee?</title>" in text
    assert "The knee in motion" in text
