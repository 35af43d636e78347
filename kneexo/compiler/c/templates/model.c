#include "NAME.h"

#include <math.h>
#include <stdbool.h>

typedef NAME_real_t real;

/* What the equations of an instant read. */
typedef struct {
    const NAME_params_t *p;
    const NAME_inputs_t *in;
@if constants
    const real *c; /* what depends on parameters alone */
@end
@if states
    const real *x; /* continuous states */
@end
@if held
    const real *d; /* discrete states */
@end
@if time
    real t; /* in s */
@end
} instant;

static bool is_finite(real value)
{
    return (value >= -@{largest}) && (value <= @{largest});
}

@if counted
static bool are_finite(const real *values, uint16_t count)
{
    bool all = true;

    for (uint16_t i = 0U; i < count; i++) {
        all = all && is_finite(values[i]);
    }
    return all;
}

@end
@if minimum
static real minimum(real a, real b)
{
    return (b < a) ? b : a;
}

@end
@if maximum
static real maximum(real a, real b)
{
    return (a < b) ? b : a;
}

@end
@if accumulators
/* Sum whose rounding error is kept for the next one (Kahan). */
static real sum(real total, real term, real *lost)
{
    const real added = term - *lost;
    const real result = total + added;

    *lost = (result - total) - added;
    return result;
}

@end
static bool inputs_are_right(const NAME_inputs_t *in)
{
@input_checks
}

static bool outputs_are_right(const NAME_outputs_t *out)
{
@output_checks
}

static bool params_are_right(const NAME_params_t *p)
{
@parameter_checks
}

@functions
@if states
/* The classical Runge-Kutta method over a sample time, in STEPS equal steps. */
static void integrate(instant *at, real *x)
{
@if time
    const real start = at->t;
@end
    real rate[STATES];
    real total[STATES];
    real z[STATES];

    for (uint16_t step = 0U; step < STEPSU; step++) {
@if time
        const real t = start + ((real)step * @{step});

@end
@if time
        at->t = t;
@end
        at->x = x;
        rate_at(at, rate);
        for (uint16_t i = 0U; i < STATESU; i++) {
            total[i] = rate[i];
            z[i] = x[i] + (@{half_step} * rate[i]);
        }
@if time
        at->t = t + @{half_step};
@end
        at->x = z;
        rate_at(at, rate);
        for (uint16_t i = 0U; i < STATESU; i++) {
            total[i] += @{two} * rate[i];
            z[i] = x[i] + (@{half_step} * rate[i]);
        }
        rate_at(at, rate);
        for (uint16_t i = 0U; i < STATESU; i++) {
            total[i] += @{two} * rate[i];
            z[i] = x[i] + (@{step} * rate[i]);
        }
@if time
        at->t = t + @{step};
@end
        rate_at(at, rate);
        for (uint16_t i = 0U; i < STATESU; i++) {
            x[i] += @{sixth_step} * (total[i] + rate[i]);
        }
    }
    at->x = x;
}

@end
@if limits
static bool is_within_limits(const instant *at)
{
    real margin[LIMITS];
    bool within = true;

    margins_at(at, margin);
    for (uint16_t i = 0U; i < LIMITSU; i++) {
        within = within && (margin[i] >= @{zero});
    }
    return within;
}

@end
static instant instant_of(const NAME_params_t *params, const NAME_state_t *state,
    const NAME_inputs_t *inputs)
{
    instant at;

@if stateless
    (void)state;
@end
    at.p = params;
    at.in = inputs;
@if constants
    at.c = state->c;
@end
@if states
    at.x = state->x;
@end
@if held
    at.d = state->d;
@end
@if time
    at.t = (real)state->tick * UPPER_SAMPLE_TIME_S;
@end
    return at;
}

static uint16_t outputs_of(const instant *at, NAME_outputs_t *outputs)
{
    uint16_t status = UPPER_OK;
    NAME_outputs_t out = *outputs;

@if outputs
    outputs_at(at, &out);
@else
    (void)at;
@end
    if (outputs_are_right(&out)) {
        *outputs = out;
    } else {
        status = UPPER_BAD_RESULT;
    }
    return status;
}

uint16_t NAME_update_parameters(NAME_state_t *state, const NAME_params_t *params)
{
    uint16_t status = UPPER_OK;
@if constants
    real c[CONSTANTS];
@else

    (void)state;
@end

    if (!params_are_right(params)) {
        status = UPPER_BAD_PARAMETER;
    }
@if constants
    if (status == UPPER_OK) {
        constants_of(params, c);
        if (are_finite(c, CONSTANTSU)) {
            for (uint16_t i = 0U; i < CONSTANTSU; i++) {
                state->c[i] = c[i];
            }
        } else {
            status = UPPER_BAD_RESULT;
        }
    }
@end
    return status;
}

uint16_t NAME_init(NAME_state_t *state, const NAME_params_t *params,
    const NAME_inputs_t *inputs)
{
    static const NAME_state_t zero = {0};
    uint16_t status;

    *state = zero;
@if states
    for (uint16_t i = 0U; i < STATESU; i++) {
        state->x[i] = params->initial_x[i];
    }
@end
@if held
    for (uint16_t i = 0U; i < HELDU; i++) {
        state->d[i] = params->initial_d[i];
    }
@end
    status = NAME_update_parameters(state, params);
    if ((status == UPPER_OK) && !inputs_are_right(inputs)) {
        status = UPPER_BAD_INPUT;
    }
    if (status == UPPER_OK) {
        const instant at = instant_of(params, state, inputs);
@if held
        real next[HELD];

        initial_at(&at, next);
        if (are_finite(next, HELDU)) {
            for (uint16_t i = 0U; i < HELDU; i++) {
                state->d[i] = next[i];
            }
        } else {
            status = UPPER_BAD_RESULT;
        }
@end
        if (status == UPPER_OK) {
            status = outputs_of(&at, &state->last);
        }
    }
    if (status == UPPER_OK) {
        state->started = 1U;
    }
    return status;
}

uint16_t NAME_step(const NAME_params_t *params, NAME_state_t *state,
    const NAME_inputs_t *inputs, NAME_outputs_t *outputs)
{
    uint16_t status = UPPER_OK;
@if ticks
    uint32_t tick = state->tick;
@end
    NAME_outputs_t last = state->last;
@if states
    real x[STATES];
@end
@if held
    real d[HELD];
@end
@if accumulators
    real lost[LOST];
@end

@if states
    for (uint16_t i = 0U; i < STATESU; i++) {
        x[i] = state->x[i];
    }
@end
@if held
    for (uint16_t i = 0U; i < HELDU; i++) {
        d[i] = state->d[i];
    }
@end
@if accumulators
    for (uint16_t i = 0U; i < LOSTU; i++) {
        lost[i] = state->lost[i];
    }
@end
    if (state->started == 0U) {
        status = UPPER_NOT_STARTED;
    } else if (!inputs_are_right(inputs)) {
        status = UPPER_BAD_INPUT;
    } else {
        instant at = instant_of(params, state, inputs);

@if limits
        if (!is_within_limits(&at)) {
            status = UPPER_OUT_OF_LIMITS;
        }
@end
@if held
        update_at(&at, @{update_arguments}d);
        at.d = d;
        if (!are_finite(d, HELDU)) {
            status = UPPER_BAD_RESULT;
        }
@end
@if states
        if (status == UPPER_OK) {
            integrate(&at, x);
            if (!are_finite(x, STATESU)) {
                status = UPPER_BAD_RESULT;
            }
        }
@end
@if ticks
        tick++;
@end
@if wraps
        if (tick == @{last_tick}U) {
            tick = @{first_tick}U;
        }
@end
        if (status == UPPER_OK) {
@if time
            at.t = (real)tick * UPPER_SAMPLE_TIME_S;
@end
            status = outputs_of(&at, &last);
        }
    }
    if (status == UPPER_OK) {
@if states
        for (uint16_t i = 0U; i < STATESU; i++) {
            state->x[i] = x[i];
        }
@end
@if held
        for (uint16_t i = 0U; i < HELDU; i++) {
            state->d[i] = d[i];
        }
@end
@if accumulators
        for (uint16_t i = 0U; i < LOSTU; i++) {
            state->lost[i] = lost[i];
        }
@end
@if ticks
        state->tick = tick;
@end
        state->last = last;
    }
    *outputs = state->last;
    return status;
}

uint16_t NAME_outputs(const NAME_params_t *params, const NAME_state_t *state,
    const NAME_inputs_t *inputs, NAME_outputs_t *outputs)
{
    uint16_t status;

    *outputs = state->last;
    if (state->started == 0U) {
        status = UPPER_NOT_STARTED;
    } else if (inputs_are_right(inputs)) {
        const instant at = instant_of(params, state, inputs);

        status = outputs_of(&at, outputs);
    } else {
        status = UPPER_BAD_INPUT;
    }
    return status;
}
