/* Replays the test vectors and prints the largest difference of each output. Ends with 0 when all
 * of them are small, else with 1. */
#include "NAME_vectors.h"

#include <math.h>
#include <stdio.h>

#define FIELDS @{fields}U

/* Largest difference that passes, as a part of the largest value of that output. */
#ifndef TOLERANCE
#define TOLERANCE @{tolerance}
#endif

static const char *const names[FIELDS] = {
@names
};

static void values_of(const NAME_outputs_t *outputs, double values[FIELDS])
{
@values
}

int main(void)
{
    NAME_state_t state;
    NAME_outputs_t outputs;
    double largest[FIELDS] = {0.0};
    double difference[FIELDS] = {0.0};
    uint32_t failures = 0U;
    uint16_t status = NAME_init(&state, &NAME_params, &NAME_vectors[0].inputs);

    if (status != UPPER_OK) {
        printf("NAME_init: status %u\n", (unsigned)status);
        failures++;
    }
    for (uint32_t k = 0U; k < UPPER_VECTORS; k++) {
        double expected[FIELDS];
        double got[FIELDS];

        status = NAME_step(&NAME_params, &state, &NAME_vectors[k].inputs, &outputs);
        if (status != UPPER_OK) {
            printf("step %lu: status %u\n", (unsigned long)k, (unsigned)status);
            failures++;
        }
        values_of(&NAME_vectors[k].outputs, expected);
        values_of(&outputs, got);
        for (uint16_t i = 0U; i < FIELDS; i++) {
            largest[i] = fmax(largest[i], fabs(expected[i]));
            difference[i] = fmax(difference[i], fabs(got[i] - expected[i]));
        }
    }
    for (uint16_t i = 0U; i < FIELDS; i++) {
        printf("%s: difference %.3g, largest value %.6g\n", names[i], difference[i], largest[i]);
        if (!(difference[i] <= TOLERANCE * largest[i])) {
            failures++;
        }
    }
    printf("%lu steps, %lu failures\n", (unsigned long)UPPER_VECTORS, (unsigned long)failures);
    return (failures == 0U) ? 0 : 1;
}
