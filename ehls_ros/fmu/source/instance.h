/* One instance of a compiled model: all its numbers in one block, and the access that both versions of FMI share.

   The model is `ehls_start`, `ehls_step`, `ehls_rates` and `ehls_change`, object code of the simulator. `model.h`, written by the
   export, has its sizes and the declarations of its variables. A value reference is the index of a variable in the block. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>
#include <stdint.h>

enum { TIME = 0, CYCLE = 1, PERIOD = 2 }; /* indices in the block */

enum { READ_ONLY = 0, FIXED = 1, TUNABLE = 2, INPUT = 3 }; /* entries of KIND */

#include "model.h"

typedef enum { CREATED, INITIALIZING, STEPPING, EVENT, CONTINUOUS, TERMINATED } Phase;

typedef struct Instance {
    double block[BLOCK];
    double start_time; /* [s] */
    Phase phase;
    int continuous; /* Model Exchange */
    int stale;      /* the outputs do not reflect the last change of a variable */
    int broken;     /* the state is not a number; only a reset or another state helps */
    void (*report)(struct Instance *, const char *text);
    void *environment;
    const char *name;
    void *callback;
} Instance;

typedef struct {
    double block[SAVED];
    double start_time;
    int32_t phase, stale, broken, model;
} State;

Instance *instance_new(int continuous, const char *token);
void instance_reset(Instance *self);
int instance_processor(void);
int instance_get(Instance *self, const unsigned int *references, size_t count, double *values);
int instance_set(Instance *self, const unsigned int *references, size_t count, const double *values);
int instance_begin(Instance *self);
int instance_do_step(Instance *self, double now, double step);
int instance_refresh(Instance *self);
int instance_events(Instance *self);
int instance_slopes(Instance *self, const unsigned int *unknown, size_t unknowns, const unsigned int *known, size_t knowns,
                    const double *seed, double *slope);
void instance_save(const Instance *self, State *state);
int instance_restore(Instance *self, const State *state);
int instance_is_state(const State *state);
void instance_report(Instance *self, const char *format, ...);

#endif
