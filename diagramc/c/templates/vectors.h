{{ first_line | comment }}
#ifndef {{ NAME }}_VECTORS_H
#define {{ NAME }}_VECTORS_H

#include "{{ name }}.h"

/* Inputs of a step, and the outputs that the step must return. */
typedef struct {
    {{ name }}_inputs_t inputs;
    {{ name }}_outputs_t outputs;
} {{ name }}_vector_t;

#define {{ NAME }}_VECTORS {{ vectors | length }}UL

extern const {{ name }}_vector_t {{ name }}_vectors[{{ NAME }}_VECTORS];

#endif
