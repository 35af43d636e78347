{{ first_line | comment }}
#ifndef {{ NAME }}_FMU_H
#define {{ NAME }}_FMU_H

#include "{{ name }}.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Text that only this FMU has. */
#define {{ NAME }}_TOKEN "{{ token }}"

typedef enum {
    {{ NAME }}_INSTANTIATED,
    {{ NAME }}_INITIALIZING,
    {{ NAME }}_STEPPING,
    {{ NAME }}_TERMINATED
} {{ name }}_mode_t;

/* Memory of an instance. */
typedef struct {
    double values[{{ variables|length }}]; /* by value reference */
    double start; /* of the experiment, in s */
    double stop; /* in s */
    {{ name }}_params_t params;
    {{ name }}_state_t state;
    uint32_t ticks; /* sample times since the start */
    {{ name }}_mode_t mode;
    bool outputs_are_fresh; /* while initializing */
    bool is_tuned; /* a parameter has changed since the last step */
} {{ name }}_memory_t;

typedef struct {
    {{ name }}_memory_t memory;
    void (*report)(void *owner, const char *text); /* of an error */
    void *owner;
} {{ name }}_fmu_t;

/* Every function returns false after an error. Then it has reported the error, and the memory is
 * unchanged. */

/* Reset the memory; every variable gets its start value. */
void {{ name }}_fmu_reset({{ name }}_fmu_t *fmu);

/* Report an error; returns false. */
bool {{ name }}_fmu_refuse({{ name }}_fmu_t *fmu, const char *text);

bool {{ name }}_fmu_set({{ name }}_fmu_t *fmu, const uint32_t *references, size_t count,
    const double *values);
bool {{ name }}_fmu_get({{ name }}_fmu_t *fmu, const uint32_t *references, size_t count, double *values);

bool {{ name }}_fmu_set_times({{ name }}_fmu_t *fmu, double start, bool has_stop, double stop);
bool {{ name }}_fmu_enter_initialization({{ name }}_fmu_t *fmu);
bool {{ name }}_fmu_exit_initialization({{ name }}_fmu_t *fmu);
bool {{ name }}_fmu_terminate({{ name }}_fmu_t *fmu);

/* Go from the communication point over a whole number of sample times. */
bool {{ name }}_fmu_step({{ name }}_fmu_t *fmu, double point, double size);

bool {{ name }}_fmu_save({{ name }}_fmu_t *fmu, void **saved);
bool {{ name }}_fmu_restore({{ name }}_fmu_t *fmu, const void *saved);
size_t {{ name }}_fmu_serialized_size(void);
bool {{ name }}_fmu_serialize({{ name }}_fmu_t *fmu, const void *saved, void *bytes, size_t size);
bool {{ name }}_fmu_deserialize({{ name }}_fmu_t *fmu, const void *bytes, size_t size, void **saved);

#endif
