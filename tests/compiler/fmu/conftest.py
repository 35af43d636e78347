"""FMUs in FMPy; tests of `export` use them too."""

import pytest


class FmuInstance:
    """An FMU in FMPy, by names of variables, in either version of the standard."""

    def __init__(self, path, guid=None, name="knee"):
        fmpy = pytest.importorskip("fmpy", reason="needs FMPy: pip install 'kneexo[fmu]'")
        from fmpy import fmi2, fmi3

        self.description = fmpy.read_model_description(path)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages = []
        self.two = self.description.fmiVersion == "2.0"
        kind = fmi2.FMU2Slave if self.two else fmi3.FMU3Slave
        self.fmu = kind(
            guid=guid or self.description.guid,
            unzipDirectory=fmpy.extract(path),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        if self.two:
            callbacks = fmi2.fmi2CallbackFunctions()
            callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log)
            self.fmu.instantiate(callbacks=callbacks)
        else:
            self.fmu.instantiate(logMessage=self._log)

    def _log(self, *arguments):
        self.messages.append(arguments[-1].decode())

    def enter(self, start=0.0, stop=None, **values):
        """Begin the initialization, with start values."""
        self.set(**values)
        if self.two:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)

    def start(self, start=0.0, stop=None, **values):
        """Initialize, with start values; returns self."""
        self.enter(start, stop, **values)
        self.fmu.exitInitializationMode()
        return self

    def set(self, values=(), **named):
        named = dict(values) | named
        names, numbers = zip(*named.items(), strict=True) if named else ((), ())
        references = [self.references[name] for name in names]
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, numbers)

    def get(self, *names):
        references = [self.references[name] for name in names]
        values = (self.fmu.getReal if self.two else self.fmu.getFloat64)(references)
        return values[0] if len(names) == 1 else values

    def step(self, time, size=0.002):
        self.fmu.doStep(time, size)

    def save(self):
        return self.fmu.getFMUstate() if self.two else self.fmu.getFMUState()

    def restore(self, state):
        (self.fmu.setFMUstate if self.two else self.fmu.setFMUState)(state)

    def serialize(self):
        state = self.save()
        return (self.fmu.serializeFMUstate if self.two else self.fmu.serializeFMUState)(state)

    def deserialize(self, data):
        fmu = self.fmu
        self.restore((fmu.deSerializeFMUstate if self.two else fmu.deserializeFMUState)(data))

    def refusal(self, call, *arguments, **named):
        """The message of a call that must fail."""
        from fmpy.fmi1 import FMICallException

        before = len(self.messages)
        with pytest.raises(FMICallException):
            call(*arguments, **named)
        (message,) = self.messages[before:]
        return message


@pytest.fixture(scope="session")
def fmu_instance():
    """The class of FMU instances; skips without FMPy."""
    pytest.importorskip("fmpy", reason="needs FMPy: pip install 'kneexo[fmu]'")
    return FmuInstance
