/* FMI 2.0 on an instance. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "instance.h"


#define SELF Instance *self = (Instance *)c
#define DONE(good) return (good) ? fmi2OK : fmi2Error

static void report(Instance *self, const char *text) {
    fmi2CallbackLogger logger = (fmi2CallbackLogger)self->callback;
    if (logger) logger(self->environment, self->name, fmi2Error, "logStatusError", "%s", text);
}

static fmi2Status unsupported(fmi2Component c, size_t count) {
    SELF;
    if (count) instance_report(self, "all variables of this model are real numbers");
    DONE(count == 0);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    fmi2CallbackLogger logger = functions ? functions->logger : NULL;
    void *environment = functions ? functions->componentEnvironment : NULL;
    const char *refused = NULL;
    Instance *self = NULL;
    if (!instance_processor()) refused = "this processor lacks AVX2 and FMA, which the model's machine code needs";
    else if ((self = instance_new(type == fmi2ModelExchange, guid)) == NULL)
        refused = "the guid is not that of the modelDescription.xml, the interface is not offered, or there is no memory";
    if (refused) {
        if (logger) logger(environment, name, fmi2Error, "logStatusError", "%s", refused);
        return NULL;
    }
    char *kept = malloc(strlen(name ? name : "") + 1);
    if (kept) self->name = strcpy(kept, name ? name : "");
    self->report = report;
    self->environment = environment;
    self->callback = (void *)logger;
    return self;
}

void fmi2FreeInstance(fmi2Component c) {
    SELF;
    if (self) {
        free((char *)self->name);
        free(self);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    SELF;
    self->start_time = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    SELF;
    self->phase = INITIALIZING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { DONE(instance_begin((Instance *)c)); }

fmi2Status fmi2Terminate(fmi2Component c) {
    SELF;
    self->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    instance_reset((Instance *)c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    DONE(instance_get((Instance *)c, vr, n, value));
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    DONE(instance_set((Instance *)c, vr, n, value));
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[]) { return unsupported(c, n); }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean v[]) { return unsupported(c, n); }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String v[]) { return unsupported(c, n); }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[]) {
    return unsupported(c, n);
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean v[]) {
    return unsupported(c, n);
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String v[]) {
    return unsupported(c, n);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (*state == NULL) *state = malloc(sizeof(State));
    if (*state == NULL) return fmi2Error;
    instance_save((Instance *)c, (State *)*state);
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { DONE(state && instance_restore((Instance *)c, (State *)state)); }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    *size = sizeof(State);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (state == NULL || size < sizeof(State)) return fmi2Error;
    memcpy(bytes, state, sizeof(State));
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    SELF;
    State *read = size == sizeof(State) ? malloc(sizeof(State)) : NULL;
    if (read) memcpy(read, bytes, sizeof(State));
    if (read == NULL || !instance_is_state(read)) {
        free(read);
        instance_report(self, "%lu bytes are no state of this model", (unsigned long)size);
        return fmi2Error;
    }
    *state = read;
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    DONE(instance_slopes((Instance *)c, unknown, unknowns, known, knowns, seed, sensitivity));
}

/* Co-Simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real step, fmi2Boolean no_return) {
    DONE(instance_do_step((Instance *)c, now, step));
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[]) {
    return n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    SELF;
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = self->start_time + self->block[TIME];
    return fmi2OK;
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { return fmi2Discard; }

/* Model Exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    SELF;
    self->phase = EVENT;
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    memset(info, 0, sizeof *info);
    info->valuesOfContinuousStatesChanged = fmi2True;
    DONE(instance_events((Instance *)c));
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    SELF;
    self->phase = CONTINUOUS;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *enter, fmi2Boolean *terminate) {
    *enter = *terminate = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    SELF;
    self->block[TIME] = time - self->start_time;
    self->stale = 1;
    return fmi2OK;
}
#if HAS_RATES
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    SELF;
    if (n != STATES) return fmi2Error;
    memcpy(self->block + FIRST_STATE, x, n * sizeof(double));
    self->stale = 1;
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    SELF;
    if (n != STATES || !instance_refresh(self)) return fmi2Error;
    memcpy(x, self->block + FIRST_STATE, n * sizeof(double));
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) {
    SELF;
    if (n != STATES || !instance_refresh(self)) return fmi2Error;
    memcpy(derivatives, self->block + FIRST_RATE, n * sizeof(double));
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    SELF;
    if (n != 1 || !instance_refresh(self)) return fmi2Error;
    indicators[0] = self->block[EVENT_INDICATOR];
    return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    if (n != STATES) return fmi2Error;
    memcpy(x, NOMINAL, n * sizeof(double));
    return fmi2OK;
}
#else
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) { return n ? fmi2Error : fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return n ? fmi2Error : fmi2OK; }
#endif
