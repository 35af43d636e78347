{{ first_line | comment }}
#ifndef {{ NAME }}_H
#define {{ NAME }}_H

#include <float.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

{% if real.name == "double" %}
#if DBL_MANT_DIG < 53
#error "double has fewer than 53 bits here: export single precision"
#endif

{% endif %}
typedef {{ real.name }} {{ name }}_real_t;

#define {{ NAME }}_SAMPLE_TIME_S {{ schedule.tick_s | literal(real, "sample_time") }}

/* Status of a call: 0 for success, or one of the codes below. A failed step leaves the state
 * unchanged{{ ", except `started`" if accepts_inputs }}. Its outputs are those of the last successful step or start, or zeros without a start{{ "," if failing else ". */" }}
{% for field in failing %}
 * {{ "but" if loop.first else "and" }} {{ field.name }} = {{ field.failed | literal(real, field.name) }}{{ ". */" if loop.last }}
{% endfor %}
{% if accepts_inputs %}
/* The model accepts all inputs, so no call returns {{ NAME }}_BAD_INPUT. After a failed step, steps return
 * {{ NAME }}_NOT_STARTED until {{ name }}_init succeeds. */
{% endif %}
#define {{ NAME }}_OK 0U
#define {{ NAME }}_BAD_INPUT 1U /* an input is not finite, or out of its range */
#define {{ NAME }}_BAD_RESULT 2U /* a result is not finite */
{% if limits %}
#define {{ NAME }}_OUT_OF_LIMITS 4U /* the state is outside the limits of a leaf system */
{% endif %}
#define {{ NAME }}_NOT_STARTED 8U /* {{ name }}_init has not succeeded yet */
#define {{ NAME }}_BAD_PARAMETER 16U /* a parameter or a start value is not finite */
{% if method %}
#define {{ NAME }}_TOO_MANY_SUBSTEPS 64U /* {{ most_substeps }} substeps do not reach the end of the sample time */
{% endif %}
{% if checks_steps %}
#define {{ NAME }}_UNSTABLE 32U /* a mode is too fast for the steps of the Runge-Kutta method */
{% endif %}

/* Context parameters of the leaf systems, in SI units, and the initial states. */
typedef struct {
{% for leaf, members in leaves.items() %}
    struct {
{% for member in members %}
        {{ name }}_real_t {{ member.name }}{{ "[%d]" | format(member.values | length) if member.is_array }};
{% endfor %}
    } {{ leaf }};
{% endfor %}
{% for letter, values in start.items() %}
    {{ name }}_real_t initial_{{ letter }}[{{ values | length }}];
{% endfor %}
{% if not numbers %}
    {{ name }}_real_t none; /* unused, for C allows no empty struct */
{% endif %}
} {{ name }}_params_t;

typedef struct {
{% for field in inputs %}
{% set ends = field.limits(real) %}
    {{ "int32_t" if field.is_integer else name ~ "_real_t" }} {{ field.name }};{{ " /* %s */" | format(ends | join(" ... ")) if ends }}
{% else %}
    {{ name }}_real_t none; /* unused, for C allows no empty struct */
{% endfor %}
} {{ name }}_inputs_t;

typedef struct {
{% for field in outputs %}
    {{ name }}_real_t {{ field.name }};
{% else %}
    {{ name }}_real_t none; /* unused, for C allows no empty struct */
{% endfor %}
} {{ name }}_outputs_t;

typedef struct {
{% for member, size, meaning in state %}
{{ meaning | comment("    ") }}
    {{ name }}_real_t {{ member }}[{{ size }}];
{% endfor %}
{% if method %}
    {{ name }}_real_t substep; /* length of the next substep of the integration in s */
{% endif %}
    {{ name }}_outputs_t last; /* outputs of the last successful step or start */
{% if counts_steps %}
    uint32_t tick; /* {{ "number of steps since the start" if needs_time else "number of the step in the cycle of sample times" }} */
{% endif %}
    uint32_t started; /* 1 after {{ name }}_init has succeeded, else 0 */
} {{ name }}_state_t;

extern const {{ name }}_params_t {{ name }}_params;

/* Identity of the code, as in manifest.json. A SHA-256 has its most significant word first. */
typedef struct {
    uint32_t version[3]; /* {{ tool }} */
    uint32_t equations[8]; /* SHA-256 of the equations */
    uint32_t parameters[8]; /* SHA-256 of the bytes of {{ name }}_params, little-endian */
    uint32_t origin[8]; /* SHA-256 of the file `origin` in manifest.json, or zeros */
} {{ name }}_manifest_t;

extern const {{ name }}_manifest_t {{ name }}_manifest;

{% if tables %}
/* Tables with a number for each value of an integer input, computed by the export. Changing a
 * parameter that only these numbers depend on has no effect. */
{% for table in tables %}
extern const {{ name }}_real_t {{ name }}_table_{{ loop.index0 }}[{{ table.values | length }}];
{% endfor %}

{% endif %}
/* Start or restart the model; the inputs are those of the first step. After a failed start, steps
 * and outputs return {{ NAME }}_NOT_STARTED until {{ name }}_init succeeds. */
uint16_t {{ name }}_init({{ name }}_state_t *state, const {{ name }}_params_t *params,
    const {{ name }}_inputs_t *inputs);

/* Change the parameters of a started model; the values of its states stay. Pass a changed copy of
 * the struct. If the status is 0, pass this copy to the next steps; otherwise keep the old struct. */
uint16_t {{ name }}_update_parameters({{ name }}_state_t *state, const {{ name }}_params_t *params);

/* Simulate one sample time with constant inputs; the outputs are those at its end. */
uint16_t {{ name }}_step(const {{ name }}_params_t *params, {{ name }}_state_t *state,
    const {{ name }}_inputs_t *inputs, {{ name }}_outputs_t *outputs);

/* Compute the outputs from the present state and these inputs, without a step. */
uint16_t {{ name }}_outputs(const {{ name }}_params_t *params, const {{ name }}_state_t *state,
    const {{ name }}_inputs_t *inputs, {{ name }}_outputs_t *outputs);

#ifdef __cplusplus
}
#endif

#endif
