"""An FMU stepped through FMPy, in this process."""

import shutil
from contextlib import contextmanager

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave


class Stepped:
    """An instance, with its variables by name."""

    def __init__(self, path, unzipped):
        description = read_model_description(path)
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.third = description.fmiVersion == "3.0"
        kind = FMU3Slave if self.third else FMU2Slave
        token = description.instantiationToken if self.third else description.guid
        self.fmu = kind(
            guid=token, unzipDirectory=unzipped, modelIdentifier=description.coSimulation.modelIdentifier, instanceName="rig"
        )
        self.messages = []
        self.time = 0.0
        self.fmu.instantiate()

    def begin(self, **start):
        if not self.third:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(**start)
        self.fmu.exitInitializationMode()
        return self

    def _numbers(self, names):
        return [self.references[name] for name in names]

    def set(self, **values):
        if not values:
            return
        setter = self.fmu.setFloat64 if self.third else self.fmu.setReal
        setter(self._numbers(values), list(values.values()))

    def get(self, *names):
        getter = self.fmu.getFloat64 if self.third else self.fmu.getReal
        return np.array(getter(self._numbers(names)))

    def step(self, length=1e-3):
        self.fmu.doStep(self.time, length)
        self.time += length

    def state(self):
        return (self.fmu.getFMUState if self.third else self.fmu.getFMUstate)()

    def restore(self, state, time):
        (self.fmu.setFMUState if self.third else self.fmu.setFMUstate)(state)
        self.time = time

    def free(self, state):
        (self.fmu.freeFMUState if self.third else self.fmu.freeFMUstate)(state)

    def serialized(self, state):
        return (self.fmu.serializeFMUState if self.third else self.fmu.serializeFMUstate)(state)

    def deserialized(self, data):
        return (self.fmu.deserializeFMUState if self.third else self.fmu.deSerializeFMUstate)(data)


@contextmanager
def stepped(path):
    unzipped = extract(str(path))
    try:
        made = Stepped(str(path), unzipped)
        try:
            yield made
        finally:
            made.fmu.terminate()
            made.fmu.freeInstance()
    finally:
        shutil.rmtree(unzipped, ignore_errors=True)
