{{ first_line | comment }}
#include "{{ name }}.h"

#include <math.h>
#include <stdbool.h>

/* Fast mathematics treats no number as NaN or infinite, so it removes the checks of this code. */
#ifdef __FAST_MATH__
#error "compile {{ name }}.c without -ffast-math"
#endif
#ifdef __FINITE_MATH_ONLY__
#if __FINITE_MATH_ONLY__ > 0
#error "compile {{ name }}.c without -ffinite-math-only"
#endif
#endif
{% if sums %}
#ifdef __ASSOCIATIVE_MATH__
#error "compile {{ name }}.c without -fassociative-math, which removes the compensated sums"
#endif
{% endif %}
#ifdef _M_FP_FAST
#error "compile {{ name }}.c without /fp:fast"
#endif

typedef {{ name }}_real_t real;

/* Data that the equations read at one instant. */
typedef struct {
    const {{ name }}_params_t *p;
    const {{ name }}_inputs_t *in;
{% if constants %}
    const real *c; /* values that depend on parameters alone */
{% endif %}
{% if states %}
    const real *x; /* continuous states */
{% endif %}
{% if discrete %}
    const real *d; /* discrete states */
{% endif %}
{% if needs_time %}
    real t; /* in s */
{% endif %}
} instant;

static bool is_finite(real value)
{
    return (value >= -{{ real.largest | literal(real) }}) && (value <= {{ real.largest | literal(real) }});
}

{% if constants or numbers or method %}
static bool are_finite(const real *values, uint16_t count)
{
    bool all = true;

    for (uint16_t i = 0U; i < count; i++) {
        all = all && is_finite(values[i]);
    }
    return all;
}

{% endif %}
{% if method or functions.calls("minimum") %}
static real minimum(real a, real b)
{
    return (b < a) ? b : a;
}

{% endif %}
{% if method or functions.calls("maximum") %}
static real maximum(real a, real b)
{
    return (a < b) ? b : a;
}

{% endif %}
{% if sums %}
/* Kahan's compensated sum: lost carries the rounding error to the next call. */
static real sum(real total, real term, real *lost)
{
    const real added = term - *lost;
    const real result = total + added;

    *lost = (result - total) - added;
    return result;
}

{% endif %}
{% if not accepts_inputs %}
static bool inputs_are_right(const {{ name }}_inputs_t *in)
{
{% for field in inputs if field.range or not field.is_integer %}
{% set ends = field.limits(real) %}
{% set inside = "(in->%s >= %s) && (in->%s <= %s)" %}
    {{ "return" if loop.first else "    &&" }} {{
        inside | format(field.name, ends[0], field.name, ends[1])
        if ends else "is_finite(in->%s)" | format(field.name)
    }}{{ ";" if loop.last }}
{% else %}
    (void)in;
    return true;
{% endfor %}
}

{% endif %}
static bool outputs_are_right(const {{ name }}_outputs_t *out)
{
{% for field in outputs %}
    {{ "return" if loop.first else "    &&" }} is_finite(out->{{ field.name }}){{ ";" if loop.last }}
{% else %}
    (void)out;
    return true;
{% endfor %}
}

{# The numbers stand in an array: less code than a call for each of them. #}
static bool params_are_right(const {{ name }}_params_t *p)
{
{% if numbers %}
    const real values[{{ numbers | length }}] = {
{% for number in numbers %}
        p->{{ number }},
{% endfor %}
    };

    return are_finite(values, {{ numbers | length }}U);
{% else %}
    (void)p;
    return true;
{% endif %}
}

{% if constants %}
static void constants_of(const {{ name }}_params_t *p, real *c)
{
{% if not functions.constants.reads("p") %}
    (void)p;
{% endif %}
{{ functions.constants.text }}
}

{% endif %}
{% set types = {
    "p": "const %s_params_t *" | format(name),
    "in": "const %s_inputs_t *" | format(name),
    "c": "const real *",
    "x": "const real *",
    "d": "const real *",
    "t": "const real ",
} %}
{% for function in functions.of_an_instant %}
static void {{ function.name }}(const instant *at{{ function.arguments }})
{
{% for member, type in types.items() if function.reads(member) %}
    {{ type }}{{ member }} = at->{{ member }};
{% else %}
    (void)at;
{% endfor %}

{% for statement in function.statements %}
{{ statement }}
{% endfor %}
}

{% endfor %}
{% set zero, one, two = 0.0 | literal(real), 1.0 | literal(real), 2.0 | literal(real) %}
{% if method %}
{% include "rosenbrock.c" %}
{% elif states %}
{% set step, half_step = schedule.step_s | literal(real, "step"), (0.5 * schedule.step_s) | literal(real, "half_step") %}
{% set stage_parts = "{%s, %s, %s, %s}" | format(zero, half_step, half_step, step) %}
{% set stage_weights = "{%s, %s, %s, %s}" | format(one, two, two, one) %}
{% endif %}
{% if checks_steps %}
/* Return whether a Runge-Kutta step is stable, by the rates of its four stages, one stage after the
 * other. For a mode l, the ratio of b and a is h |l| with the step h, and that of c and a is
 * (h |l|)^2. In smooth rates of a single mode the check fails from h |l| = {{ stability }} on. */
static bool is_stable(const real *x, const real *rate)
{
    real a_squared = {{ ((smallest_change / schedule.step_s) ** 2) | literal(real, "rounding errors") }};
    real b_squared = {{ zero }};
    real c_squared = {{ zero }};

    for (uint16_t i = 0U; i < {{ states }}U; i++) {
        const real scale = {{ one }} / ({{ one }} + ((x[i] < {{ zero }}) ? -x[i] : x[i]));
        const real a = (rate[i + {{ states }}U] - rate[i]) * ({{ 0.5 | literal(real) }} * scale);
        const real b = (rate[i + {{ 2 * states }}U] - rate[i + {{ states }}U]) * scale;
        const real c = ((rate[i] - rate[i + {{ 2 * states }}U]) + (rate[i + {{ 3 * states }}U] - rate[i + {{ 2 * states }}U])) * scale;

        a_squared += a * a;
        b_squared += b * b;
        c_squared += c * c;
    }
    return (b_squared <= ({{ (stability ** 2) | literal(real) }} * a_squared)) || (c_squared <= ({{ (stability ** 4) | literal(real) }} * a_squared));
}

{% endif %}
{% if method %}
{# Two forms of RK4. Scalars around one evaluation of the derivatives leave compilers free to use
   registers, and a function of arrays does not. But compilers move all constants of a long
   evaluation out of the loops. #}
{% elif states and functions.is_large %}
/* Integrate over a sample time by the classical Runge-Kutta method, in {{ schedule.steps }} equal steps.
 * Return whether all states are finite. */
static bool integrate(const instant *start, real *x{{ ", bool *stable" if checks_steps }})
{
    static const real part[4] = {{ stage_parts }}; /* of the step, in s */
    static const real weight[4] = {{ stage_weights }};
    instant at = *start;
    real rate[{{ states }}];
    real total[{{ states }}];
    real z[{{ states }}];
{% if checks_steps %}
    real last[{{ 4 * states }}]; /* rates at the stages of the last step */
{% endif %}

    at.x = z;
    for (uint16_t step = 0U; step < {{ schedule.steps }}U; step++) {
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
            rate[i] = {{ zero }};
            total[i] = {{ zero }};
        }
        for (uint16_t stage = 0U; stage < 4U; stage++) {
{% if needs_time %}
            at.t = (start->t + ((real)step * {{ step }})) + part[stage];
{% endif %}
            for (uint16_t i = 0U; i < {{ states }}U; i++) {
                z[i] = x[i] + (part[stage] * rate[i]);
            }
            rate_at(&at, rate);
            for (uint16_t i = 0U; i < {{ states }}U; i++) {
                total[i] += weight[stage] * rate[i];
            }
{% if checks_steps %}
            if (step == {{ schedule.steps - 1 }}U) {
                for (uint16_t i = 0U; i < {{ states }}U; i++) {
                    last[(stage * {{ states }}U) + i] = rate[i];
                }
            }
{% endif %}
        }
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
            x[i] += {{ (schedule.step_s / 6.0) | literal(real, "sixth_step") }} * total[i];
        }
    }
{% if checks_steps %}
    *stable = is_stable(x, last);
{% endif %}
    return are_finite(x, {{ states }}U);
}

{% elif states %}
/* Integrate over a sample time by the classical Runge-Kutta method, in {{ schedule.steps }} equal steps.
 * Return whether all states are finite. If one is not, it and the states after it are not stored. */
static bool integrate(const instant *at, real *x{{ ", bool *stable" if checks_steps }})
{
{% if functions.stage_states or functions.rates.reads("t") %}
    static const real part[4] = {{ stage_parts }}; /* of the step, in s */
{% endif %}
    static const real weight[4] = {{ stage_weights }};
{% for member, type in types.items() if member != "t" and functions.integration_reads(member) %}
    {{ type }}{{ member }} = at->{{ member }};
{% endfor %}
{% if not functions.integration_reads("p", "in", "c", "d", "t") %}
    (void)at;
{% endif %}
{% for i in range(states) %}
    real x{{ i }} = x[{{ i }}];
{% endfor %}
{% if checks_steps %}
    real last[{{ 4 * states }}]; /* rates at the stages of the last step */
{% endif %}

{% for statement in functions.tick_values.statements %}
{{ statement }}
{{ "\n" if loop.last }}
{%- endfor %}
    for (uint16_t step = 0U; step < {{ schedule.steps }}U; step++) {
{% if functions.rates.reads("t") %}
        const real start = at->t + ((real)step * {{ step }});
{% endif %}
{% for i in range(states) %}
        real rate{{ i }} = {{ zero }};
        real total{{ i }} = {{ zero }};
{% endfor %}

        for (uint16_t stage = 0U; stage < 4U; stage++) {
{% if functions.rates.reads("t") %}
            const real t = start + part[stage];
{% endif %}
{% for i in functions.stage_states %}
            const real z{{ i }} = x{{ i }} + (part[stage] * rate{{ i }});
{% endfor %}
{% for statement in functions.rates.statements %}
{{ statement }}
{% endfor %}

{% for i in range(states) %}
            total{{ i }} += weight[stage] * rate{{ i }};
{% endfor %}
{% if checks_steps %}
            if (step == {{ schedule.steps - 1 }}U) {
{% for i in range(states) %}
                last[(stage * {{ states }}U) + {{ i }}U] = rate{{ i }};
{% endfor %}
            }
{% endif %}
        }
{% for i in range(states) %}
        x{{ i }} += {{ (schedule.step_s / 6.0) | literal(real, "sixth_step") }} * total{{ i }};
{% endfor %}
    }
{% for i in range(states) %}
    {{ "bool finite =" if loop.first else "finite = finite &&" }} is_finite(x{{ i }});
    if (finite) {
        x[{{ i }}] = x{{ i }};
    }
{% endfor %}
{% if checks_steps %}
    *stable = is_stable(x, last);
{% endif %}
    return finite;
}

{% endif %}
{% if limits %}
static bool is_within_limits(const instant *at)
{
    real margin[{{ limits }}];
    bool within = true;

    margins_at(at, margin);
    for (uint16_t i = 0U; i < {{ limits }}U; i++) {
        within = within && (margin[i] >= {{ 0.0 | literal(real) }});
    }
    return within;
}

{% endif %}
static instant instant_of(const {{ name }}_params_t *params, const {{ name }}_state_t *state,
    const {{ name }}_inputs_t *inputs)
{
    instant at;

{% if not (states or discrete or constants or needs_time) %}
    (void)state;
{% endif %}
    at.p = params;
    at.in = inputs;
{% if constants %}
    at.c = state->c;
{% endif %}
{% if states %}
    at.x = state->x;
{% endif %}
{% if discrete %}
    at.d = state->d;
{% endif %}
{% if needs_time %}
    at.t = (real)state->tick * {{ NAME }}_SAMPLE_TIME_S;
{% endif %}
    return at;
}

{% if failing %}
static void set_failed({{ name }}_outputs_t *outputs)
{
{% for field in failing %}
    outputs->{{ field.name }} = {{ field.failed | literal(real, field.name) }};
{% endfor %}
}

{% endif %}
static uint16_t outputs_of(const instant *at, {{ name }}_outputs_t *outputs)
{
    uint16_t status = {{ NAME }}_OK;
    {{ name }}_outputs_t out = *outputs;

{% if outputs %}
    outputs_at(at, &out);
{% else %}
    (void)at;
{% endif %}
    if (outputs_are_right(&out)) {
        *outputs = out;
    } else {
        status = {{ NAME }}_BAD_RESULT;
    }
    return status;
}

uint16_t {{ name }}_update_parameters({{ name }}_state_t *state, const {{ name }}_params_t *params)
{
    uint16_t status = {{ NAME }}_OK;
{% if constants %}
    real c[{{ constants }}];
{% else %}

    (void)state;
{% endif %}

    if (!params_are_right(params)) {
        status = {{ NAME }}_BAD_PARAMETER;
    }
{% if constants %}
    if (status == {{ NAME }}_OK) {
        constants_of(params, c);
        if (are_finite(c, {{ constants }}U)) {
            for (uint16_t i = 0U; i < {{ constants }}U; i++) {
                state->c[i] = c[i];
            }
        } else {
            status = {{ NAME }}_BAD_RESULT;
        }
    }
{% endif %}
    return status;
}

uint16_t {{ name }}_init({{ name }}_state_t *state, const {{ name }}_params_t *params,
    const {{ name }}_inputs_t *inputs)
{
{# A constant, because memset and sizeof count bytes, of which some processors have 16 bits. #}
    static const {{ name }}_state_t zero = {0};
    uint16_t status;

    *state = zero;
{% if states %}
    for (uint16_t i = 0U; i < {{ states }}U; i++) {
        state->x[i] = params->initial_x[i];
    }
{% if method %}
    state->substep = {{ NAME }}_SAMPLE_TIME_S;
{% endif %}
{% endif %}
{% if discrete %}
    for (uint16_t i = 0U; i < {{ discrete }}U; i++) {
        state->d[i] = params->initial_d[i];
    }
{% endif %}
    status = {{ name }}_update_parameters(state, params);
{% if not accepts_inputs %}
    if ((status == {{ NAME }}_OK) && !inputs_are_right(inputs)) {
        status = {{ NAME }}_BAD_INPUT;
    }
{% endif %}
    if (status == {{ NAME }}_OK) {
        const instant at = instant_of(params, state, inputs);
{% if discrete %}
        real next[{{ discrete }}];

        initial_at(&at, next);
        if (are_finite(next, {{ discrete }}U)) {
            for (uint16_t i = 0U; i < {{ discrete }}U; i++) {
                state->d[i] = next[i];
            }
        } else {
            status = {{ NAME }}_BAD_RESULT;
        }
{% endif %}
        if (status == {{ NAME }}_OK) {
            status = outputs_of(&at, &state->last);
        }
    }
    if (status == {{ NAME }}_OK) {
        state->started = 1U;
    }
    return status;
}

uint16_t {{ name }}_step(const {{ name }}_params_t *params, {{ name }}_state_t *state,
    const {{ name }}_inputs_t *inputs, {{ name }}_outputs_t *outputs)
{
    uint16_t status = {{ NAME }}_OK;
{% if counts_steps %}
    uint32_t tick = state->tick;
{% endif %}
    {{ name }}_outputs_t last = state->last;
{% if states %}
    real x[{{ states }}];
{% endif %}
{% if method %}
    real substep = state->substep;
{% endif %}
{% if discrete %}
    real d[{{ discrete }}];
{% endif %}
{% if sums %}
    real lost[{{ sums }}];
{% endif %}

{% if states %}
    for (uint16_t i = 0U; i < {{ states }}U; i++) {
        x[i] = state->x[i];
    }
{% endif %}
{% if discrete %}
    for (uint16_t i = 0U; i < {{ discrete }}U; i++) {
        d[i] = state->d[i];
    }
{% endif %}
{% if sums %}
    for (uint16_t i = 0U; i < {{ sums }}U; i++) {
        lost[i] = state->lost[i];
    }
{% endif %}
    if (state->started == 0U) {
        status = {{ NAME }}_NOT_STARTED;
{% if accepts_inputs %}
    } else if (!params_are_right(params)) {
        status = {{ NAME }}_BAD_PARAMETER;
{% else %}
    } else if (!inputs_are_right(inputs)) {
        status = {{ NAME }}_BAD_INPUT;
{% endif %}
    } else {
        instant at = instant_of(params, state, inputs);

{% if limits %}
        if (!is_within_limits(&at)) {
            status = {{ NAME }}_OUT_OF_LIMITS;
        }
{% endif %}
{% if discrete %}
        update_at(&at, {{ "tick, " if schedule.counts_ticks }}{{ "lost, " if sums }}d);
        at.d = d;
        if (!are_finite(d, {{ discrete }}U)) {
            status = {{ NAME }}_BAD_RESULT;
        }
{% endif %}
{% if states %}
        if (status == {{ NAME }}_OK) {
{% if method %}
            if (!integrate(&at, x, &substep)) {
                status = {{ NAME }}_TOO_MANY_SUBSTEPS;
            }
{% elif checks_steps %}
            bool stable = true;

            if (!integrate(&at, x, &stable)) {
                status = {{ NAME }}_BAD_RESULT;
            } else if (!stable) {
                status = {{ NAME }}_UNSTABLE;
            } else {
                /* all rates are finite, and the step is stable */
            }
{% else %}
            if (!integrate(&at, x)) {
                status = {{ NAME }}_BAD_RESULT;
            }
{% endif %}
            at.x = x;
        }
{% endif %}
{% if counts_steps %}
        tick++;
{% endif %}
{# A count of ticks that only finds due updates begins a new cycle, so that it never overflows. #}
{% if schedule.counts_ticks and not needs_time %}
        if (tick == {{ schedule.cycle[1] }}U) {
            tick = {{ schedule.cycle[0] }}U;
        }
{% endif %}
        if (status == {{ NAME }}_OK) {
{% if needs_time %}
            at.t = (real)tick * {{ NAME }}_SAMPLE_TIME_S;
{% endif %}
            status = outputs_of(&at, &last);
        }
    }
    if (status == {{ NAME }}_OK) {
{% if states %}
        for (uint16_t i = 0U; i < {{ states }}U; i++) {
            state->x[i] = x[i];
        }
{% endif %}
{% if method %}
        state->substep = substep;
{% endif %}
{% if discrete %}
        for (uint16_t i = 0U; i < {{ discrete }}U; i++) {
            state->d[i] = d[i];
        }
{% endif %}
{% if sums %}
        for (uint16_t i = 0U; i < {{ sums }}U; i++) {
            state->lost[i] = lost[i];
        }
{% endif %}
{% if counts_steps %}
        state->tick = tick;
{% endif %}
        state->last = last;
    }
    *outputs = state->last;
{% if failing or accepts_inputs %}
    if (status != {{ NAME }}_OK) {
{% if failing %}
        set_failed(outputs);
{% endif %}
{% if accepts_inputs %}
        state->started = 0U; /* the model is wrong, not an input: only a start ends the failure */
{% endif %}
    }
{% endif %}
    return status;
}

uint16_t {{ name }}_outputs(const {{ name }}_params_t *params, const {{ name }}_state_t *state,
    const {{ name }}_inputs_t *inputs, {{ name }}_outputs_t *outputs)
{
    uint16_t status;

    *outputs = state->last;
    if (state->started == 0U) {
        status = {{ NAME }}_NOT_STARTED;
{% if accepts_inputs %}
    } else if (!params_are_right(params)) {
        status = {{ NAME }}_BAD_PARAMETER;
{% endif %}
    } else {{ "if (inputs_are_right(inputs)) " if not accepts_inputs }}{
        const instant at = instant_of(params, state, inputs);

        status = outputs_of(&at, outputs);
{% if not accepts_inputs %}
    } else {
        status = {{ NAME }}_BAD_INPUT;
{% endif %}
    }
{% if failing %}
    if (status != {{ NAME }}_OK) {
        set_failed(outputs);
    }
{% endif %}
    return status;
}
