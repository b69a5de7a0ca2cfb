/* FMI 3.0 on an instance. */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "instance.h"

#define SELF Instance *self = (Instance *)c
#define DONE(good) return (good) ? fmi3OK : fmi3Error

static void report(Instance *self, const char *text) {
    fmi3LogMessageCallback log = (fmi3LogMessageCallback)self->callback;
    if (log) log(self->environment, fmi3Error, "logStatusError", text);
}

static fmi3Status unsupported(fmi3Instance c, size_t count) {
    if (count) instance_report((Instance *)c, "all variables of this model are of type Float64");
    DONE(count == 0);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[]) { return fmi3OK; }

static fmi3Instance instantiate(int continuous, fmi3String name, fmi3String token, void *environment,
                                fmi3LogMessageCallback log) {
    const char *refused = NULL;
    Instance *self = NULL;
    if (!instance_processor()) refused = "this processor lacks AVX2 and FMA, which the model's machine code needs";
    else if ((self = instance_new(continuous, token)) == NULL)
        refused = "the token is not that of the modelDescription.xml, the interface is not offered, or there is no memory";
    if (refused) {
        if (log) log(environment, fmi3Error, "logStatusError", refused);
        return NULL;
    }
    self->report = report;
    self->environment = environment;
    self->callback = (void *)log;
    return self;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    return instantiate(1, name, token, environment, log);
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[], size_t count,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    return instantiate(0, name, token, environment, log);
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
                                               fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    if (log) log(environment, fmi3Error, "logStatusError", "this model has no Scheduled Execution");
    return NULL;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean has_stop, fmi3Float64 stop) {
    SELF;
    self->start_time = start;
    self->phase = INITIALIZING;
    return fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { DONE(instance_begin((Instance *)c)); }
fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    SELF;
    self->phase = EVENT;
    return fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance c) {
    SELF;
    self->phase = TERMINATED;
    return fmi3OK;
}
fmi3Status fmi3Reset(fmi3Instance c) {
    instance_reset((Instance *)c);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t count) {
    DONE(n == count && instance_get((Instance *)c, vr, n, values));
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t count) {
    DONE(n == count && instance_set((Instance *)c, vr, n, values));
}

#define NO_VARIABLES(TYPE) \
    fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##TYPE values[], size_t count) { \
        return unsupported(c, n); \
    } \
    fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##TYPE values[], size_t count) { \
        return unsupported(c, n); \
    }
NO_VARIABLES(Float32)
NO_VARIABLES(Int8)
NO_VARIABLES(UInt8)
NO_VARIABLES(Int16)
NO_VARIABLES(UInt16)
NO_VARIABLES(Int32)
NO_VARIABLES(UInt32)
NO_VARIABLES(Int64)
NO_VARIABLES(UInt64)
NO_VARIABLES(Boolean)
NO_VARIABLES(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[],
                         size_t count) {
    return unsupported(c, n);
}
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t count) {
    return unsupported(c, n);
}
fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]) {
    return unsupported(c, n);
}
fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[]) {
    return unsupported(c, n);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) { return fmi3Error; }
fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[],
                                       size_t n) {
    return fmi3Error;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    if (*state == NULL) *state = malloc(sizeof(State));
    if (*state == NULL) return fmi3Error;
    instance_save((Instance *)c, (State *)*state);
    return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { DONE(state && instance_restore((Instance *)c, (State *)state)); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    *size = sizeof(State);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    if (state == NULL || size < sizeof(State)) return fmi3Error;
    memcpy(bytes, state, sizeof(State));
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    State *read = size == sizeof(State) ? malloc(sizeof(State)) : NULL;
    if (read) memcpy(read, bytes, sizeof(State));
    if (read == NULL || !instance_is_state(read)) {
        free(read);
        instance_report((Instance *)c, "%lu bytes are no state of this model", (unsigned long)size);
        return fmi3Error;
    }
    *state = read;
    return fmi3OK;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,
                                        const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
    DONE(seeds == knowns && sensitivities == unknowns &&
         instance_slopes((Instance *)c, unknown, unknowns, known, knowns, seed, sensitivity));
}
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t unknowns,
                                    const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,
                                    fmi3Float64 sensitivity[], size_t sensitivities) {
    return fmi3Error;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return fmi3Error; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return fmi3Error; }
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[]) {
    return fmi3Error;
}
fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]) {
    return fmi3Error;
}
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[]) {
    return fmi3Error;
}
fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[],
                                fmi3UInt64 resolutions[]) {
    return fmi3Error;
}
fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[]) {
    return fmi3Error;
}
fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[]) {
    return fmi3Error;
}
fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[]) {
    return fmi3Error;
}
fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[]) {
    return fmi3Error;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *next, fmi3Float64 *time) {
    SELF;
    *again = *terminate = *nominals = *next = fmi3False;
    *values = self->continuous ? fmi3True : fmi3False;
    DONE(self->continuous ? instance_events(self) : 1);
}

/* Model Exchange */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    SELF;
    self->phase = CONTINUOUS;
    return fmi3OK;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set, fmi3Boolean *enter, fmi3Boolean *terminate) {
    *enter = *terminate = fmi3False;
    return fmi3OK;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) {
    SELF;
    self->block[TIME] = time - self->start_time;
    self->stale = 1;
    return fmi3OK;
}
#if HAS_RATES
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    SELF;
    if (n != STATES) return fmi3Error;
    memcpy(self->block + FIRST_STATE, x, n * sizeof(double));
    self->stale = 1;
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    SELF;
    if (n != STATES || !instance_refresh(self)) return fmi3Error;
    memcpy(x, self->block + FIRST_STATE, n * sizeof(double));
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    SELF;
    if (n != STATES || !instance_refresh(self)) return fmi3Error;
    memcpy(derivatives, self->block + FIRST_RATE, n * sizeof(double));
    return fmi3OK;
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    SELF;
    if (n != 1 || !instance_refresh(self)) return fmi3Error;
    indicators[0] = self->block[EVENT_INDICATOR];
    return fmi3OK;
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    if (n != STATES) return fmi3Error;
    memcpy(x, NOMINAL, n * sizeof(double));
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    *n = 1;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    *n = STATES;
    return fmi3OK;
}
#else
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return n ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return n ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) { return n ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 x[], size_t n) { return n ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return n ? fmi3Error : fmi3OK; }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    *n = 0;
    return fmi3OK;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    *n = 0;
    return fmi3OK;
}
#endif

/* Co-Simulation */

fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    SELF;
    self->phase = STEPPING;
    return fmi3OK;
}
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[],
                                    fmi3Float64 values[], size_t count) {
    return n ? fmi3Error : fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 step, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached) {
    SELF;
    int good = instance_do_step(self, now, step);
    *event = *terminate = *early = fmi3False;
    *reached = self->start_time + self->block[TIME];
    DONE(good);
}
fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) { return fmi3Error; }
