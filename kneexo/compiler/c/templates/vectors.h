#ifndef UPPER_VECTORS_H
#define UPPER_VECTORS_H

#include "NAME.h"

/* Inputs of a step, and the outputs that must follow. */
typedef struct {
    NAME_inputs_t inputs;
    NAME_outputs_t outputs;
} NAME_vector_t;

#define UPPER_VECTORS @{vectors}UL

extern const NAME_vector_t NAME_vectors[UPPER_VECTORS];

#endif
