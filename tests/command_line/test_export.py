import pytest

from kneexo.command_line.main import main


@pytest.mark.parametrize(
    ("form", "measured"), [("c", "encoder count"), ("fmu", "encoder reading (rad)")]
)
def test_the_help_names_the_measurement_of_the_controller(form, measured, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["export", form, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert f"the controller, from {measured} and knee reference" in text
