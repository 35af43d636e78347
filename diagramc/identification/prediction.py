"""What a model with given unknowns predicts at the stamps of logs, and its Jacobian."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import Error
from ..model import CompiledModel
from ..native.runner import output_elements
from ..run_data import Array, InputTable, State
from .log import Log, Segment, Unknown, table_from

At = Callable[[Mapping[str, float], Log], tuple[Array, State, InputTable]]
"""Function of the unknowns by name and of a log: parameters, initial state and inputs of a run."""
SENSOR = {"delay_s": 0.0, "gain": 1.0, "bias": 0.0}
"""What a sensor can have, with the values where it is not unknown."""
_STEP = 1e-3
"""Step of the central differences, as a share of the range.

The runs keep a relative tolerance of 1e-8 and so spoil a derivative by about 1e-5. A range of a
decade gives a truncation of (1e-3 ln 10)²/6 = 1e-6.
"""


class Prediction:
    """Runs of a model to the stamps of segments. Unknowns are places ``z`` in their ranges."""

    def __init__(
        self,
        model: CompiledModel,
        segments: Sequence[Segment],
        elements: Sequence[str],
        unknowns: Sequence[Unknown],
        at: At,
        options: Mapping[str, Any],
        fixed: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Give each segment its own unknowns for the initial states; ``fixed`` has known values."""
        self.model, self.segments, self.elements, self.at = model, segments, elements, at
        states = {*model.state_names, *model.discrete_names}
        self.columns = [(u, -1) for u in unknowns if u.name not in states]
        for index in range(len(segments)):
            self.columns += [(u, index) for u in unknowns if u.name in states]
        self.unknowns = [unknown for unknown, _ in self.columns]
        self.names = [u.name + segments[i].label * (i >= 0) for u, i in self.columns]
        self.fixed, self.options = dict(fixed), dict(options)
        port_of = dict(output_elements(model.outputs))
        self.ports = list(dict.fromkeys(port_of[name] for name in elements))
        recorded = output_elements({port: model.outputs[port] for port in self.ports})
        self.recorded = [[name for name, _ in recorded].index(name) for name in elements]
        self._predicted = self._exact = self._slopes = np.array(math.nan), list[Array]()
        if not model.sample_times_s:  # the commands then change at ticks
            self.options["record_period_s"] = segments[0].log.sample_time_s

    def _values(self, z: Array, index: int) -> dict[str, float]:
        """Return the unknowns by name for the segment ``index``."""
        columns = zip(self.columns, z, strict=True)
        return self.fixed | {u.name: u.value(p) for (u, own), p in columns if own in (-1, index)}

    def case(self, index: int, z: Array) -> tuple[Array, State, InputTable]:
        """Return parameters, initial state and inputs of the run of the segment ``index``."""
        segment, values = self.segments[index], self._values(z, index)
        parameters, state, inputs = self.at(values, segment.log)
        x, d = (
            np.array([values.get(n, float(v)) for n, v in zip(names, vector, strict=True)])
            for names, vector in (
                (self.model.state_names, state.continuous),
                (self.model.discrete_names, state.discrete),
            )
        )
        return parameters, State(x, d), table_from(inputs, segment.start_s)

    def predictions(self, index: int, zs: Sequence[Array]) -> list[Any]:
        """Return the predicted values (rows, elements) of a segment for ``zs``, or errors.

        Those that differ in their sensors alone are one run. Runs that record at the same times go
        in lanes.
        """
        time_s = self.segments[index].time_s[:, None, None]
        of_sensors = {f"{name}.{kind}" for name in self.elements for kind in SENSOR}
        sensors, keys, raw = [], [], {}
        delays_of: dict[Any, dict[tuple[float, ...], Array]] = {}
        for z in zs:
            values = self._values(z, index)
            delay, gain, bias = (
                np.array([values.get(f"{name}.{kind}", default) for name in self.elements])
                for kind, default in SENSOR.items()
            )
            key = tuple(v for name, v in values.items() if name not in of_sensors)
            delays_of.setdefault(key, {})[tuple(delay)] = z
            keys.append((key, tuple(delay)))
            sensors.append((gain, bias))
        groups: dict[Any, dict[Any, Array]] = {}
        for key, delays in delays_of.items():
            groups.setdefault(tuple(delays), {})[key] = next(iter(delays.values()))
        for delays, members in groups.items():
            shown_s = time_s - np.transpose(delays)  # (rows, elements, delays)
            times, places = np.unique(shown_s, return_inverse=True)
            parameters, states, inputs = zip(
                *(self.case(index, z) for z in members.values()), strict=True
            )
            runs = self.model.simulate_batch(
                parameters,
                states,
                times[-1],
                inputs=inputs,
                outputs=self.ports,
                record_times_s=times,
                failures="return",
                **self.options,
            )
            rows = np.moveaxis(places.reshape(shown_s.shape), 2, 0)
            for key, run in zip(members, runs, strict=True):
                for delay, of_delay in zip(delays, rows, strict=True):
                    raw[key, delay] = run
                    if not isinstance(run, Error):
                        record = np.concatenate([run[port] for port in self.ports], axis=1)
                        raw[key, delay] = record[of_delay, self.recorded]
        return [
            raw[key] if isinstance(raw[key], Error) else gain * raw[key] + bias
            for key, (gain, bias) in zip(keys, sensors, strict=True)
        ]

    def predict(self, z: Array) -> list[Array]:
        """Return the predicted values (rows, elements) of each segment.

        Raises the error of a run that fails.
        """
        if not np.array_equal(z, self._predicted[0]):
            runs = (_succeeded(self.predictions(i, [z]))[0] for i in range(len(self.segments)))
            self._predicted = z.copy(), [*runs]
        return self._predicted[1]

    def slopes(self, z: Array) -> list[Array]:
        """Return the derivatives of `jacobian` to about 0.1 % of each, enough for a search.

        If the search has moved by less than the step of the differences, they are those of before.
        """
        if not np.all(np.abs(z - self._slopes[0]) <= _STEP):
            self._slopes = z.copy(), self._differences(z, central=False)
        return self._slopes[1]

    def jacobian(self, z: Array) -> list[Array]:
        """Return the derivatives of the predicted values by z, (rows, elements, columns).

        Raises the error of a run that fails.
        """
        if not np.array_equal(z, self._exact[0]):
            self._exact = self._slopes = z.copy(), self._differences(z, central=True)
        return self._exact[1]

    def _differences(self, z: Array, *, central: bool) -> list[Array]:
        result = []
        for index, segment in enumerate(self.segments):
            own = [c for c, (_, only) in enumerate(self.columns) if only in (-1, index)]
            place, count = z[own], len(own)
            if central:  # but one-sided at a bound, where the model may have no value beyond
                ends = np.clip(place + np.array([[_STEP], [-_STEP]]), 0.0, 1.0)
            else:
                ends = np.stack([place + np.where(place < 0.5, _STEP, -_STEP), place])
            zs = np.repeat(z[None], 2 * count, axis=0)
            zs[np.arange(2 * count), own * 2] = ends.ravel()
            runs = np.array(_succeeded(self.predictions(index, list(zs))))
            piece = np.zeros((*segment.measured.shape, z.size))
            differences = (runs[:count] - runs[count:]) / (ends[0] - ends[1])[:, None, None]
            piece[:, :, own] = np.moveaxis(differences, 0, -1)
            result.append(piece)
        return result


def _succeeded(runs: list[Any]) -> list[Array]:
    for run in runs:
        if isinstance(run, Error):
            raise run
    return runs
