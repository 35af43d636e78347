{{ first_line | comment }}
#ifndef {{ NAME }}_FMU_H
#define {{ NAME }}_FMU_H

#include "{{ name }}.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* GUID or instantiation token: a text that identifies this FMU. */
#define {{ NAME }}_TOKEN "{{ token }}"

typedef enum {
    {{ NAME }}_INSTANTIATED,
    {{ NAME }}_INITIALIZING,
    {{ NAME }}_STEPPING,
    {{ NAME }}_TERMINATED
} {{ name }}_mode_t;

/* Values, state and mode of an instance: the content of a saved FMU state. */
typedef struct {
    double values[{{ variables|length }}]; /* of all variables, by value reference */
    double start; /* start time of the experiment in s */
    double stop; /* stop time in s */
    {{ name }}_params_t params;
    {{ name }}_state_t state;
    uint32_t ticks; /* number of sample times since the start */
    {{ name }}_mode_t mode;
    bool outputs_are_fresh; /* while initializing: values has the outputs for the present inputs */
    bool is_tuned; /* a parameter has changed since the last step */
} {{ name }}_memory_t;

typedef struct {
    {{ name }}_memory_t memory;
    void (*report)(void *owner, const char *text); /* reports the text of an error */
    void *owner;
} {{ name }}_fmu_t;

/* Every function of type bool reports an error and returns false if it fails. Then the memory is
 * unchanged{{ ", but for the outputs that a failure of the model sets" if failing }}. */

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

/* Simulate size seconds from the communication point: a whole number of sample times. */
bool {{ name }}_fmu_step({{ name }}_fmu_t *fmu, double point, double size);

bool {{ name }}_fmu_save({{ name }}_fmu_t *fmu, void **saved);
bool {{ name }}_fmu_restore({{ name }}_fmu_t *fmu, const void *saved);
size_t {{ name }}_fmu_serialized_size(void);
bool {{ name }}_fmu_serialize({{ name }}_fmu_t *fmu, const void *saved, void *bytes, size_t size);
bool {{ name }}_fmu_deserialize({{ name }}_fmu_t *fmu, const void *bytes, size_t size, void **saved);

#endif
