#ifndef UPPER_FMU_H
#define UPPER_FMU_H

#include "NAME.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What tells this FMU from all others. */
#define UPPER_TOKEN "@{token}"

typedef enum {
    UPPER_INSTANTIATED,
    UPPER_INITIALIZING,
    UPPER_STEPPING,
    UPPER_TERMINATED
} NAME_mode_t;

/* All that an instance remembers. */
typedef struct {
    double values[VARIABLES]; /* by value reference */
    double start; /* of the experiment, in s */
    double stop; /* in s */
    NAME_params_t params;
    NAME_state_t state;
    uint32_t ticks; /* sample times since the start */
    NAME_mode_t mode;
    bool outputs_are_fresh; /* while initializing */
    bool is_tuned; /* a parameter has changed since the last step */
} NAME_memory_t;

typedef struct {
    NAME_memory_t memory;
    void (*report)(void *owner, const char *text); /* of an error */
    void *owner;
} NAME_fmu_t;

/* Of all functions: false is an error, which was reported; the memory is then as before. */

/* Forget all; every variable has its start value. */
void NAME_fmu_reset(NAME_fmu_t *fmu);

/* Report an error; returns false. */
bool NAME_fmu_refuse(NAME_fmu_t *fmu, const char *text);

bool NAME_fmu_set(NAME_fmu_t *fmu, const uint32_t *references, size_t count,
    const double *values);
bool NAME_fmu_get(NAME_fmu_t *fmu, const uint32_t *references, size_t count, double *values);

bool NAME_fmu_set_times(NAME_fmu_t *fmu, double start, bool has_stop, double stop);
bool NAME_fmu_enter_initialization(NAME_fmu_t *fmu);
bool NAME_fmu_exit_initialization(NAME_fmu_t *fmu);
bool NAME_fmu_terminate(NAME_fmu_t *fmu);

/* From the communication point on, a whole number of sample times. */
bool NAME_fmu_step(NAME_fmu_t *fmu, double point, double size);

bool NAME_fmu_save(NAME_fmu_t *fmu, void **saved);
bool NAME_fmu_restore(NAME_fmu_t *fmu, const void *saved);
size_t NAME_fmu_serialized_size(void);
bool NAME_fmu_serialize(NAME_fmu_t *fmu, const void *saved, void *bytes, size_t size);
bool NAME_fmu_deserialize(NAME_fmu_t *fmu, const void *bytes, size_t size, void **saved);

#endif
