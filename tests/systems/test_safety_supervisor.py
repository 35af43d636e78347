"""The safety state machine: each transition, the whole graph, and three implementations."""

import ctypes
import itertools
import subprocess
from typing import get_args

import numpy as np
import pytest

from diagramc import Interface, read_diagram
from diagramc.c.source import source_of
from diagramc.c.vectors import recorded_vectors
from diagramc.testing import check_leaf
from kneexo.parameters import ProtectionParameters
from kneexo.parameters.device.safety_states import (
    DETECTORS,
    EVENTS,
    LAW_ACTS,
    REASONS,
    STATES,
    TRANSITIONS,
    SafeState,
    transitions,
)
from kneexo.systems import SafetySupervisor

T = 0.002
RPM = 2 * np.pi / 60
HEALTHY, OVERDUE = 3, 6  # samples
STOP = 1000.0  # rad/s², 2 rad/s each sample
SAFE_STATES = ("zero_speed", "dynamic_brake")
RELEASES = ("dynamic_brake", "torque_off", "bypass")
NAMES = ("motor_speed_command", "motor_speed", *DETECTORS, "emergency_stop", "reset")
PORTS = ("motor_speed_command", "motor_speed", "detected", "emergency_stop", "reset")
OUTPUTS = ("motor_speed_command", "safety_state", "safety_reason", "release")


def supervisor(safe_state="zero_speed"):
    parameters = ProtectionParameters(
        healthy_s=HEALTHY * T,
        overdue_s=OVERDUE * T,
        stop_rad_s2=STOP,
        standstill_rpm=10.0,
        safe_state=safe_state,
    )
    return SafetySupervisor(parameters, T)


class Machine:
    """The machine as plain statements, written from the documentation alone."""

    def __init__(self, safe_state):
        self.releases = safe_state != "zero_speed"
        self.state, self.reason, self.own = "starting", 0, 0.0
        self.samples = self.clear = 0
        self.was_clear = True

    def outputs(self, row):
        command = row[0] if self.state in ("starting", "operating") else self.own
        number = list(STATES).index(self.state)
        return [command, number, self.reason, float(self.state == "released")]

    def step(self, row):
        command = self.outputs(row)[0]
        speed, detected, emergency = abs(row[1]), row[2:8], not -0.5 <= row[8] <= 0.5
        self.clear = 0 if any(detected) else self.clear + 1
        self.samples += 1
        risen = self.was_clear and 0.5 < row[9] < np.inf
        self.was_clear = -0.5 <= row[9] <= 0.5
        implausible, disobeyed, away = any(detected[:4]), detected[4] > 0, detected[5] > 0
        state, safe = self.state, "released" if self.releases else "stopped"
        standstill = self.own == 0.0 and speed < 10.0 * RPM
        overdue = self.samples >= OVERDUE
        if state == "starting":
            if emergency or implausible:
                state = "stopping"
            elif self.clear >= HEALTHY:
                state = "operating"
            elif overdue:
                state = "stopping"
        elif state == "operating":
            if emergency or implausible:
                state = "stopping"
            elif disobeyed:
                state = "released" if self.releases else "stopping"
            elif away:
                state = "stopping"
        elif state == "stopping":
            if (self.releases and disobeyed) or standstill or overdue:
                state = safe
        elif risen and not (emergency or implausible):
            state = "starting"
        if state in ("starting", "operating"):
            self.reason = 0
        elif self.state in ("starting", "operating"):
            first = [n for n, value in enumerate(detected, 1) if value]
            self.reason = 7 if emergency else (first or [8])[0]
        change = min(abs(command), STOP * T)
        self.own = command - np.sign(command) * change if state == "stopping" else 0.0
        if state != self.state:
            self.samples = 0
        self.state = state


def oracle(rows, safe_state):
    machine, found = Machine(safe_state), []
    for row in rows:
        found.append(machine.outputs(row))
        machine.step(row)
    return np.array(found)


def leaf_run(rows, system):
    """Outputs of the leaf in a Context at each sample, before the update."""
    context, found = system.CreateDefaultContext(), []
    for row in rows:
        for name, values in zip(PORTS, np.split(row, [1, 2, 8, 9]), strict=True):
            system.GetInputPort(name).FixValue(context, values)
        found.append([system.GetOutputPort(name).Eval(context)[0] for name in OUTPUTS])
        update = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0).CopyToVector()
        context.SetDiscreteState(0, update)
    return np.array(found)


def random_rows(count, seed=0):
    """Inputs that visit all states often: faults and stops are rare, and last some samples."""
    random = np.random.default_rng(seed)
    rows = np.zeros((count, len(NAMES)))
    rows[:, 0] = random.integers(-8, 9, count)
    rows[:, 1] = random.integers(-3, 4, count)
    rows[:, 2:8] = random.random((count, 6)) < 0.03
    rows[:, 8] = random.random(count) < 0.03
    rows[:, 9] = random.random(count) < 0.3
    odd = random.choice([np.nan, np.inf, -np.inf, -0.51, -0.5, 0.5, 0.51, 1e308], (count, 3))
    for column, values, share in zip((1, 8, 9), odd.T, (0.05, 0.01, 0.1), strict=True):
        rows[:, column] = np.where(random.random(count) < share, values, rows[:, column])
    lasting = np.repeat(random.random((count // 8 + 1, 6)) < 0.05, 8, axis=0)[:count]
    rows[:, 2:8] = np.maximum(rows[:, 2:8], lasting)
    return rows


# ------------------------------------------------------------------------------- the table


def test_the_table_has_known_names_and_one_next_state_for_each_event():
    for safe_state in SAFE_STATES:
        rows = transitions(safe_state)
        assert len({(row.state, row.event) for row in rows}) == len(rows)
        priorities = [list(EVENTS).index(row.event) for row in rows]
        assert priorities == sorted(priorities)
    used = {row.state for row in TRANSITIONS} | {row.next_state for row in TRANSITIONS}
    assert used == set(STATES)
    assert {row.event for row in TRANSITIONS} == set(EVENTS)
    assert {detector.event for detector in DETECTORS.values()} <= set(EVENTS)
    assert len(REASONS) == len(DETECTORS) + 3


@pytest.mark.parametrize("safe_state", SAFE_STATES)
def test_enumeration_each_state_is_reached_and_each_can_be_left_to_the_law(safe_state):
    rows = transitions(safe_state)
    after = {state: {row.next_state for row in rows if row.state == state} for state in STATES}

    def reached(start):
        found, new = {start}, {start}
        while new:
            new = set().union(*(after[state] for state in new)) - found
            found |= new
        return found

    other = {"zero_speed": "released", "dynamic_brake": "stopped"}[safe_state]
    assert reached("starting") == set(STATES) - {other}
    assert all("operating" in reached(state) for state in STATES)
    for row in rows:  # nothing but a reset lets the law act again after a stop
        if row.state not in LAW_ACTS and row.next_state in LAW_ACTS:
            assert row.event == "reset"
        if row.event in ("emergency", "implausible"):
            assert row.next_state not in LAW_ACTS
    for state in LAW_ACTS:
        assert {"emergency", "implausible"} <= {row.event for row in rows if row.state == state}


# ------------------------------------------------------------------- the leaf, by hand


def rows_of(count, **columns):
    rows = np.zeros((count, len(NAMES)))
    for name, values in columns.items():
        rows[:, NAMES.index(name)] = values
    return rows


def test_a_quick_stop_falls_with_the_rate_latches_and_waits_for_the_rise_of_reset():
    rows = rows_of(
        16,
        motor_speed_command=5.0,
        flow=[0] * 4 + [1] + [0] * 11,
        reset=[1] * 10 + [0] * 2 + [1] * 4,
    )
    found = leaf_run(rows, supervisor())
    np.testing.assert_array_equal(found[:, 0], [5] * 5 + [3, 1] + [0] * 6 + [5] * 3)
    np.testing.assert_array_equal(
        found[:, 1], [0] * 3 + [1] * 2 + [2] * 3 + [3] * 5 + [0] + [1] * 2
    )
    np.testing.assert_array_equal(found[:, 2], [0] * 5 + [3] * 8 + [0] * 3)
    assert not found[:, 3].any()


def test_the_first_reason_stays():
    rows = rows_of(10, speed=[0] * 4 + [1] * 6, emergency_stop=[0] * 6 + [1] * 4)
    found = leaf_run(rows, supervisor())
    assert [REASONS[int(n)] for n in found[4:7, 2]] == ["none", "speed", "speed"]
    assert REASONS[int(found[-1, 2])] == "speed"


def test_all_releases_have_one_machine():
    assert set(get_args(SafeState)) == {"zero_speed", *RELEASES}
    assert {transitions(name) for name in RELEASES} == {transitions("dynamic_brake")}


def test_a_motor_that_does_not_obey_is_released_at_once():
    rows = rows_of(8, motor_speed_command=5.0, speed=[0] * 4 + [1] * 4)
    found = leaf_run(rows, supervisor("bypass"))
    np.testing.assert_array_equal(found[:, 3], [0] * 5 + [1] * 3)
    np.testing.assert_array_equal(found[5:, 0], 0.0)


def test_a_start_that_does_not_become_healthy_ends():
    rows = rows_of(8, following=1.0)
    found = leaf_run(rows, supervisor())
    assert found[:, 1].tolist() == [0.0] * OVERDUE + [2.0, 3.0]
    assert REASONS[int(found[-1, 2])] == "following"
    rows = rows_of(8, emergency_stop=[1] + [0] * 7)
    assert REASONS[int(leaf_run(rows, supervisor())[-1, 2])] == "emergency stop"


def test_the_emergency_stop_is_pressed_unless_it_is_a_clear_zero():
    for value in (np.nan, np.inf, -np.inf, 0.51, -0.51, 1e308, 0.5, -0.5):
        found = leaf_run(rows_of(6, emergency_stop=[0] * 4 + [value] * 2), supervisor())
        assert found[-1, 1] == (1.0 if abs(value) == 0.5 else 2.0)


def test_inputs_of_the_operator_may_be_unconnected():
    system = supervisor()
    context = system.CreateDefaultContext()
    for name, values in (("motor_speed_command", [1.0]), ("motor_speed", [0.0])):
        system.GetInputPort(name).FixValue(context, values)
    system.GetInputPort("detected").FixValue(context, np.zeros(6))
    update = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0).CopyToVector()
    assert update.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 0.0]


def test_scalars_dependencies_and_parameters():
    system = supervisor()
    inputs = {
        "motor_speed_command": [(5.0, 8.0)],
        "motor_speed": [(0.2, 0.4)],
        "detected": [(0.2, 0.8)] * 6,
        "emergency_stop": [(0.1, 0.4)],
        "reset": [(0.1, 0.4)],
    }
    state = [(1.9, 2.1), (0.9, 1.1), (5.0, 8.0), (1.1, 1.4), (1.1, 1.4), (0.1, 0.4)]
    check_leaf(system, inputs | {"discrete_state": state})


# --------------------------------------------------------------- three implementations


@pytest.mark.parametrize("safe_state", SAFE_STATES)
def test_the_leaf_is_the_machine_of_the_documentation_and_takes_each_transition(safe_state):
    rows = random_rows(600)
    found = leaf_run(rows, supervisor(safe_state))
    np.testing.assert_array_equal(found, oracle(rows, safe_state))


@pytest.mark.parametrize("safe_state", SAFE_STATES)
def test_random_inputs_cover_each_transition(safe_state):
    """So the comparisons of this file run through each pair of states of the table."""
    states = oracle(random_rows(5000), safe_state)[:, 1].astype(int)
    seen = {(list(STATES)[a], list(STATES)[b]) for a, b in itertools.pairwise(states)}
    table = {(row.state, row.next_state) for row in transitions(safe_state)}
    reached = {row.next_state for row in transitions(safe_state) if row.state in LAW_ACTS}
    reached |= {"stopped" if safe_state == "zero_speed" else "released", *LAW_ACTS}
    assert all(a == b for a, b in seen - table)
    assert {pair for pair in table if pair[0] in reached} <= seen


DRIVER = """
#include "m.h"
int run(const double *rows, double *found, long count, long length) {
    static m_state_t state;
    for (long k = 0; k < count; k++) {
        const m_inputs_t *in = (const m_inputs_t *)(rows + 10 * k);
        if (k % length == 0 && m_init(&state, &m_params, in)) return 1;
        if (m_outputs(&m_params, &state, in, (m_outputs_t *)(found + 4 * k))) return 2;
        m_outputs_t after;
        if (m_step(&m_params, &state, in, &after)) return 3;
    }
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("safe_state", SAFE_STATES)
def test_machine_code_and_exported_c_are_the_machine_on_random_sequences(safe_state, tmp_path):
    length, sequences = 12, 100_000
    source, system = exported(safe_state, tmp_path)
    rows = random_rows(length * sequences)
    found = np.zeros((len(rows), len(OUTPUTS)))
    library = ctypes.CDLL(str(tmp_path / "library.so"))
    doubles = ctypes.POINTER(ctypes.c_double)
    arrays = (values.ctypes.data_as(doubles) for values in (rows, found))
    assert library.run(*arrays, ctypes.c_long(len(rows)), ctypes.c_long(length)) == 0
    for first in range(0, len(rows), length):
        sequence = slice(first, first + length)
        expected = oracle(rows[sequence].tolist(), safe_state)
        assert np.array_equal(found[sequence], expected), first
    # Machine code records the outputs just before the next updates, with the inputs before these.
    stream = np.where(np.isfinite(rows[:50_000]), rows[:50_000], -1.0)  # as a run requires
    recorded = recorded_vectors(system, source, stream).outputs
    states = oracle([*stream.tolist(), stream[-1].tolist()], safe_state)[1:, 1:]
    np.testing.assert_array_equal(recorded[:, 1:], states)


def exported(safe_state, folder):
    """The supervisor as `CSource`, and as a library in the folder; the source and the system."""
    system = supervisor(safe_state)
    interface = Interface(accepts_inputs=True)
    source = source_of(read_diagram(system, inputs=PORTS), "m", interface=interface)
    for name, text in (source.files() | {"driver.c": DRIVER}).items():
        (folder / name).write_text(text)
    command = ["cc", "-std=c99", "-O1", "-shared", "-fPIC", "m.c", "m_params.c", "driver.c"]
    subprocess.run([*command, "-o", "library.so", "-lm"], cwd=folder, check=True)
    return source, system
