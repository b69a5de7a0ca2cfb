#include "instance.h"

#include <cpuid.h>
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

/* Numba's calling convention: a result, an exception (never raised here), and one array of doubles as
   owner, parent, count, size of an item, data, length, stride. */
#define ENTRY(name) \
    int32_t name(int64_t *result, void **exception, void *owner, void *parent, int64_t count, int64_t size, double *data, \
                 int64_t length, int64_t stride)
ENTRY(ehls_start);
ENTRY(ehls_step);
#if HAS_RATES
ENTRY(ehls_rates);
ENTRY(ehls_change);
#endif

#if HAS_SLOPES
ENTRY(ehls_slopes);
#endif

#define CALL(name, self) call(name, (self)->block)

int format_text(char *text, size_t size, const char *format, va_list arguments);

static int call(ENTRY((*entry)), double *block) {
    int64_t result = 0;
    void *exception = NULL;
    return entry(&result, &exception, NULL, NULL, BLOCK, sizeof(double), block, BLOCK, sizeof(double)) == 0;
}

static const double TOLERANCE = 1e-6; /* of times, as a fraction of the sample period */

void instance_report(Instance *self, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    format_text(text, sizeof text, format, arguments);
    va_end(arguments);
    if (self->report) self->report(self, text);
}

/* Return whether the processor has AVX2, FMA and BMI2, and the system keeps the wide registers. */
int instance_processor(void) {
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & (1u << 12)) || !(c & (1u << 27)) || !(c & (1u << 28))) return 0;
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    if ((low & 6u) != 6u) return 0;
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & (1u << 5)) && (b & (1u << 8));
}

Instance *instance_new(int continuous, const char *token) {
    if (token == NULL || strcmp(token, TOKEN) != 0 || (continuous && !HAS_RATES)) return NULL;
    Instance *self = calloc(1, sizeof(Instance));
    if (self == NULL) return NULL;
    self->continuous = continuous;
    instance_reset(self);
    return self;
}

void instance_reset(Instance *self) {
    memcpy(self->block, START, sizeof START);
    memset(self->block + VISIBLE_AND_MEMORY, 0, (BLOCK - VISIBLE_AND_MEMORY) * sizeof(double));
    self->start_time = 0.0;
    self->phase = CREATED;
    self->stale = 1;
    self->broken = 0;
}

/* Bring the outputs up to date. */
int instance_refresh(Instance *self) {
    if (!self->stale) return 1;
    if (self->phase == CREATED || self->phase == INITIALIZING) {
        if (!CALL(ehls_start, self)) return 0;
    }
#if HAS_RATES
    if (self->continuous && !CALL(ehls_rates, self)) return 0;
#endif
    self->stale = 0;
    return 1;
}

int instance_get(Instance *self, const unsigned int *references, size_t count, double *values) {
    if (!instance_refresh(self)) return 0;
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= VISIBLE) {
            instance_report(self, "value reference %u: there are %d variables", references[i], VISIBLE);
            return 0;
        }
        values[i] = references[i] == TIME ? self->start_time + self->block[TIME] : self->block[references[i]];
    }
    return 1;
}

int instance_set(Instance *self, const unsigned int *references, size_t count, const double *values) {
    int before = self->phase == CREATED || self->phase == INITIALIZING;
    for (size_t i = 0; i < count; i++) {
        unsigned int place = references[i];
        if (place >= VISIBLE) {
            instance_report(self, "value reference %u: there are %d variables", place, VISIBLE);
            return 0;
        }
        if (KIND[place] == READ_ONLY || (KIND[place] == FIXED && !before)) {
            instance_report(self, "%s cannot be set %s", NAME[place], KIND[place] == FIXED ? "after initialization" : "");
            return 0;
        }
        if (!(values[i] >= MINIMUM[place] && values[i] <= MAXIMUM[place])) {
            instance_report(self, "%s is %g; expected %g to %g %s", NAME[place], values[i], MINIMUM[place], MAXIMUM[place],
                            UNIT[place]);
            return 0;
        }
    }
    for (size_t i = 0; i < count; i++) self->block[references[i]] = values[i];
    self->stale = before || self->continuous;
    return 1;
}

static int is_finite(Instance *self) {
    for (int i = FIRST_OUTPUT; i < AFTER_OUTPUTS; i++) {
        if (!(fabs(self->block[i]) <= DBL_MAX)) {
            instance_report(self, "%s became %g at %g s: unsuitable parameters or inputs", NAME[i], self->block[i],
                            self->start_time + self->block[TIME]);
            self->broken = 1;
            return 0;
        }
    }
    return 1;
}

int instance_begin(Instance *self) {
    self->stale = 1;
    if (!instance_refresh(self) || !is_finite(self)) return 0;
    self->phase = self->continuous ? EVENT : STEPPING;
    return 1;
}

int instance_do_step(Instance *self, double now, double step) {
    double period = self->block[PERIOD], reached = self->start_time + self->block[TIME];
    double periods = floor(step / period + 0.5);
    if (self->broken) {
        instance_report(self, "the state is not a number since an earlier step");
        return 0;
    }
    if (fabs(now - reached) > TOLERANCE * period) {
        instance_report(self, "a step from %.9g s, but the model is at %.9g s", now, reached);
        return 0;
    }
    if (!(periods >= 1.0) || fabs(step - periods * period) > TOLERANCE * period) {
        instance_report(self, "a step of %.9g s; expected a multiple of the sample period, %.9g s", step, period);
        return 0;
    }
    for (double i = 0.0; i < periods; i += 1.0) {
        if (!CALL(ehls_step, self)) return 0;
        self->block[TIME] = self->block[CYCLE] * period;
        if (!is_finite(self)) return 0;
    }
    return 1;
}

/* Change the modes until no event is due; at most as often as there can be modes to change. */
int instance_events(Instance *self) {
#if HAS_RATES
    for (int i = 0; i < 64; i++) {
        if (!CALL(ehls_rates, self)) return 0;
        if (!(self->block[EVENT_INDICATOR] > 0.0)) break;
        if (!CALL(ehls_change, self)) return 0;
    }
    self->stale = 1;
    return instance_refresh(self) && is_finite(self);
#else
    (void)self;
    return 0;
#endif
}

/* Write the derivatives of some variables in the direction of seeds, at constant modes. */
int instance_slopes(Instance *self, const unsigned int *unknown, size_t unknowns, const unsigned int *known, size_t knowns,
                    const double *seed, double *slope) {
#if HAS_SLOPES
    if (!self->continuous || !instance_refresh(self)) return 0;
    memset(self->block + SEED, 0, VISIBLE * sizeof(double));
    memset(self->block + SLOPE, 0, VISIBLE * sizeof(double));
    for (size_t i = 0; i < knowns; i++) {
        if (known[i] >= VISIBLE) return 0;
        self->block[SEED + known[i]] += seed[i];
    }
    if (!CALL(ehls_slopes, self)) return 0;
    for (size_t i = 0; i < unknowns; i++) {
        if (unknown[i] >= VISIBLE) return 0;
        slope[i] = self->block[SLOPE + unknown[i]];
    }
    return 1;
#else
    (void)self;
    return 0;
#endif
}

void instance_save(const Instance *self, State *state) {
    memcpy(state->block, self->block, sizeof state->block);
    state->start_time = self->start_time;
    state->phase = self->phase;
    state->stale = self->stale;
    state->broken = self->broken;
    state->model = MODEL_NUMBER;
}

int instance_is_state(const State *state) {
    return state->model == MODEL_NUMBER && state->phase >= CREATED && state->phase <= TERMINATED;
}

int instance_restore(Instance *self, const State *state) {
    if (!instance_is_state(state)) return 0;
    memcpy(self->block, state->block, sizeof state->block);
    self->start_time = state->start_time;
    self->phase = (Phase)state->phase;
    self->stale = state->stale;
    self->broken = state->broken;
    return 1;
}
