{{ first_line | comment }}
/* Replays the test vectors and prints the largest difference of each output from its expected
 * values. The exit code is 0 if no call fails and no difference is above TOLERANCE, else 1. */
#include "{{ name }}_vectors.h"

#include <math.h>
#include <stdio.h>

#define FIELDS {{ outputs | length }}U

/* Largest accepted difference of an output, divided by the output's largest magnitude. */
#ifndef TOLERANCE
#define TOLERANCE {{ tolerance }}
#endif

static const char *const names[FIELDS] = {
{% for field in outputs %}
    "{{ field.name }}",
{% endfor %}
};

static void values_of(const {{ name }}_outputs_t *outputs, double values[FIELDS])
{
{% for field in outputs %}
    values[{{ loop.index0 }}] = (double)outputs->{{ field.name }};
{% endfor %}
}

static void print_checksum(const char *name, const uint32_t words[8])
{
    printf("SHA-256 of the %s: ", name);
    for (uint16_t i = 0U; i < 8U; i++) {
        printf("%08lx", (unsigned long)words[i]);
    }
    printf("\n");
}

int main(void)
{
    {{ name }}_state_t state;
    {{ name }}_outputs_t outputs;
    double largest[FIELDS] = {0.0};
    double difference[FIELDS] = {0.0};
    uint32_t failures = 0U;
    uint16_t status = {{ name }}_init(&state, &{{ name }}_params, &{{ name }}_vectors[0].inputs);

    print_checksum("equations", {{ name }}_manifest.equations);
    print_checksum("parameters", {{ name }}_manifest.parameters);
    if (status != {{ NAME }}_OK) {
        printf("{{ name }}_init: status %u\n", (unsigned)status);
        failures++;
    }
    for (uint32_t k = 0U; k < {{ NAME }}_VECTORS; k++) {
        double expected[FIELDS];
        double got[FIELDS];

        status = {{ name }}_step(&{{ name }}_params, &state, &{{ name }}_vectors[k].inputs, &outputs);
        if (status != {{ NAME }}_OK) {
            printf("step %lu: status %u\n", (unsigned long)k, (unsigned)status);
            failures++;
        }
        values_of(&{{ name }}_vectors[k].outputs, expected);
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
    printf("%lu steps, %lu failures\n", (unsigned long){{ NAME }}_VECTORS, (unsigned long)failures);
    return (failures == 0U) ? 0 : 1;
}
