"""The page of the protection has the tables of the package, row by row."""

from pathlib import Path

from kneexo.parameters.device.safety_states import DETECTORS, EVENTS, STATES, TRANSITIONS

PAGE = (Path(__file__).parents[3] / "docs" / "scenario_files.md").read_text()


def table(first_column):
    """Rows of the table of the section whose head begins with ``first_column``."""
    section = PAGE.split("\n## Protection\n")[1].split("\n## ")[0]
    _, _, rest = section.partition(f"| {first_column} |")
    lines = rest.partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip(" `") for cell in line.strip("|").split(" | ")] for line in lines]


def test_the_page_has_all_states_and_events():
    states = [f"{number} {name}" for number, name in enumerate(STATES)]
    assert table("state | what the supervisor does") == [
        [name, text] for name, text in zip(states, STATES.values(), strict=True)
    ]
    assert table("event | when") == [[name, text.strip("`")] for name, text in EVENTS.items()]


def test_the_page_has_all_transitions():
    safe_states = {None: "any", False: "zero_speed", True: "any other"}
    assert table("state | event | next state | with the safe state") == [
        [row.state, row.event, row.next_state, safe_states[row.release]] for row in TRANSITIONS
    ]


def test_the_page_has_all_detectors():
    rows = table("detector | residual | threshold | event")
    assert [(name, field, event) for name, _, field, event in rows] == [
        (name, detector.field, detector.event) for name, detector in DETECTORS.items()
    ]
