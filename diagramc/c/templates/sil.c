{{ first_line | comment }}
/* Software in the loop: closes the loop of {{ controller.name }} and {{ plant.name }}, and compares each step with
 * their test vectors. The exit code is 0 if no call fails and no difference is above TOLERANCE, else
 * 1. Inputs that no other module computes come from the test vectors. */
#include "{{ controller.name }}_vectors.h"
#include "{{ plant.name }}_vectors.h"

#include <math.h>
#include <stdio.h>

#define FIELDS {{ outputs | length }}U
#define STEPS {{ controller.name | upper }}_VECTORS
#if STEPS != {{ plant.name | upper }}_VECTORS
#error "the test vectors of {{ controller.name }} and {{ plant.name }} differ in length"
#endif

/* Largest accepted difference of an output, divided by the output's largest magnitude. */
#ifndef TOLERANCE
#define TOLERANCE {{ tolerance }}
#endif

static const char *const names[FIELDS] = {
{% for _, field in outputs %}
    "{{ field.name }}",
{% endfor %}
};

static void values_of(const {{ controller.name }}_outputs_t *{{ controller.name }}_out,
    const {{ plant.name }}_outputs_t *{{ plant.name }}_out, double values[FIELDS])
{
{% for module, field in outputs %}
    values[{{ loop.index0 }}] = (double){{ module }}_out->{{ field.name }};
{% endfor %}
}

int main(void)
{
    {{ controller.name }}_state_t controller;
    {{ controller.name }}_outputs_t commands;
    {{ plant.name }}_state_t plant;
    {{ plant.name }}_outputs_t signals;
    double largest[FIELDS] = {0.0};
    double difference[FIELDS] = {0.0};
    uint32_t failures = 0U;

    if ({{ plant.name }}_init(&plant, &{{ plant.name }}_params, &{{ plant.name }}_vectors[0].inputs) != 0U) {
        printf("{{ plant.name }}_init fails\n");
        failures++;
    }
    signals = plant.last;
    for (uint32_t k = 0U; k < STEPS; k++) {
        {{ controller.name }}_inputs_t measured = {{ controller.name }}_vectors[k].inputs;
        {{ plant.name }}_inputs_t actuated = {{ plant.name }}_vectors[k].inputs;
        double expected[FIELDS];
        double got[FIELDS];

{% for field, value in measured %}
        measured.{{ field }} = {{ value }};
{% endfor %}
        if ((k == 0U) && ({{ controller.name }}_init(&controller, &{{ controller.name }}_params, &measured) != 0U)) {
            printf("{{ controller.name }}_init fails\n");
            failures++;
        }
        if ({{ controller.name }}_step(&{{ controller.name }}_params, &controller, &measured, &commands) != 0U) {
            printf("{{ controller.name }}: step %lu fails\n", (unsigned long)k);
            failures++;
        }
{% for field in actuated %}
        actuated.{{ field }} = ({{ plant.name }}_real_t)commands.{{ field }};
{% endfor %}
        if ({{ plant.name }}_step(&{{ plant.name }}_params, &plant, &actuated, &signals) != 0U) {
            printf("{{ plant.name }}: step %lu fails\n", (unsigned long)k);
            failures++;
        }
        values_of(&{{ controller.name }}_vectors[k].outputs, &{{ plant.name }}_vectors[k].outputs, expected);
        values_of(&commands, &signals, got);
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
    printf("%lu steps, %lu failures\n", (unsigned long)STEPS, (unsigned long)failures);
    return (failures == 0U) ? 0 : 1;
}
