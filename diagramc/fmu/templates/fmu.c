{{ first_line | comment }}
#include "{{ name }}_fmu.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* First value reference of each group of variables; the time has the value reference 0. */
#define FIRST_INPUT 1U
#define FIRST_TUNABLE {{ first_tunable }}U
#define FIRST_FIXED {{ first_fixed }}U
#define FIRST_OUTPUT {{ first_output }}U
#define FIRST_CONSTANT {{ first_constant }}U

{# Importers sum their steps: the sum of 20,000 steps is wrong by 3e-9 s, and ticks are counted
   here. So the point may be farther off than a step, which decides how many ticks follow. #}
/* Allowed distance of communication point and step size from the grid, in sample times. */
#define POINT_SLACK 1e-2
#define SIZE_SLACK 1e-6

#define LONGEST_TEXT 600U

typedef struct {
    const char *name;
    const char *unit; /* after a space; empty without a unit */
    double start;
    double low;
    double high;
} variable;

static const variable variables[{{ variables|length }}] = {
{% for variable in variables %}
{% set unit = " " ~ variable.unit.name if variable.unit else "" %}
{% set numbers = [variable.start or 0.0, variable.low, variable.high] %}
    { {{- variable.name | quoted }}, {{ unit | quoted }}
{%- for number in numbers %}, {{ number | literal(real, variable.name) }}{% endfor %}},
{% endfor %}
};

static void read_parameters(const double *v, {{ name }}_params_t *p)
{
{% for member, reference, parameter in assignments %}
{% set divisor = parameter.divisor | literal(real, parameter.name) %}
    p->{{ member }} = v[{{ reference }}]{{ " / " ~ divisor if parameter.divisor != 1.0 }};
{% else %}
    (void)v;
    (void)p;
{% endfor %}
}

{% if inputs | selectattr("is_integer") | list %}
/* Return the number of a count; a value that no int32_t has becomes the smallest one. */
static int32_t count_of(double value)
{
    return ((value >= (double)INT32_MIN) && (value <= (double)INT32_MAX)) ? (int32_t)value : INT32_MIN;
}

{% endif %}
static void read_inputs(const double *v, {{ name }}_inputs_t *in)
{
{% for field in inputs %}
    in->{{ field.name }} = {{ ("count_of(v[%d])" if field.is_integer else "v[%d]") | format(loop.index) }};
{% else %}
    (void)v;
    (void)in;
{% endfor %}
}

static void store_results(const {{ name }}_outputs_t *out, double *v)
{
{% for field in outputs %}
    v[{{ first_output + loop.index0 }}] = out->{{ field.name }};
{% else %}
    (void)v;
    (void)out;
{% endfor %}
}

/* ------------------------------------------------------------------------------ reports */

bool {{ name }}_fmu_refuse({{ name }}_fmu_t *fmu, const char *text)
{
    fmu->report(fmu->owner, text);
    return false;
}

static void append(char *text, const char *more)
{
    const size_t length = strlen(text);

    (void)snprintf(&text[length], LONGEST_TEXT - length, "%s", more);
}

static void append_value(char *text, const char *before, const char *name, double value,
    const char *unit)
{
    const size_t length = strlen(text);

    (void)snprintf(&text[length], LONGEST_TEXT - length, "%s%s = %.9g%s", before, name, value,
        unit);
}

static bool refuse_value({{ name }}_fmu_t *fmu, const variable *of, double value)
{
    char text[LONGEST_TEXT] = "";

    append_value(text, "", of->name, value, of->unit);
    append(text, ": must be finite");
    if ((of->low > -DBL_MAX) || (of->high < DBL_MAX)) {
        append_value(text, ", ", "lowest", of->low, of->unit);
        append_value(text, ", ", "highest", of->high, of->unit);
    }
    return {{ name }}_fmu_refuse(fmu, text);
}

static bool refuse_variable({{ name }}_fmu_t *fmu, uint32_t reference, const char *why)
{
    char text[LONGEST_TEXT] = "";

    append(text, variables[reference].name);
    append(text, why);
    return {{ name }}_fmu_refuse(fmu, text);
}

/* Report the status of a failed call of the model in words; returns false. */
static bool refuse_status({{ name }}_fmu_t *fmu, const char *what, double time, uint16_t status)
{
{% if failing %}
    /* A model that is not started has the outputs of a failed call. */
    static const {{ name }}_state_t not_started = {0};
    static const {{ name }}_inputs_t none = {0};
    {{ name }}_outputs_t out;
{% endif %}
    const double *v = fmu->memory.values;
    char text[LONGEST_TEXT] = "";

{% if failing %}
    (void){{ name }}_outputs(&fmu->memory.params, &not_started, &none, &out);
{% for field in failing %}
    fmu->memory.values[{{ first_output + outputs.index(field) }}] = out.{{ field.name }};
{% endfor %}
{% endif %}
    append_value(text, "", "t", time, " s");
    append(text, ": ");
    append(text, what);
    append_value(text, " failed, ", "status", (double)status, "");
    if ((status & {{ NAME }}_BAD_INPUT) != 0U) {
        append(text, ": an input is not finite or out of its range");
        for (uint32_t i = FIRST_INPUT; i < FIRST_TUNABLE; i++) {
            if (!((v[i] >= variables[i].low) && (v[i] <= variables[i].high))) {
                append_value(text, ", ", variables[i].name, v[i], variables[i].unit);
            }
        }
    }
    if ((status & {{ NAME }}_BAD_RESULT) != 0U) {
        append(text, ": a result is not finite; check parameters and inputs");
    }
{% if limits %}
    if ((status & {{ NAME }}_OUT_OF_LIMITS) != 0U) {
        append(text, {{ (": the state is outside the limits of %s" | format(limits | join(", "))) | quoted }});
    }
{% endif %}
{% if checks_steps %}
    if ((status & {{ NAME }}_UNSTABLE) != 0U) {
        append(text, ": a mode is too fast for the steps of RK4; export the FMU with a shorter step_s "
            "or with the integrator rosenbrock");
    }
{% endif %}
{% if method %}
    if ((status & {{ NAME }}_TOO_MANY_SUBSTEPS) != 0U) {
        append(text, ": {{ most_substeps }} substeps do not meet the tolerance; check parameters and inputs");
    }
{% endif %}
    if ((status & {{ NAME }}_NOT_STARTED) != 0U) {
        append(text, ": the model is not started; initialize the instance again");
    }
    if ((status & {{ NAME }}_BAD_PARAMETER) != 0U) {
        append(text, ": a parameter or start value of the model is not finite");
    }
    return {{ name }}_fmu_refuse(fmu, text);
}

/* ------------------------------------------------------------------------------- values */

void {{ name }}_fmu_reset({{ name }}_fmu_t *fmu)
{
    {{ name }}_memory_t *m = &fmu->memory;

    (void)memset(m, 0, sizeof *m);
    for (uint32_t i = 0U; i < {{ variables|length }}U; i++) {
        m->values[i] = variables[i].start;
    }
    m->stop = HUGE_VAL;
    m->params = {{ name }}_params;
    m->mode = {{ NAME }}_INSTANTIATED;
}

static bool is_known({{ name }}_fmu_t *fmu, uint32_t reference)
{
    char text[LONGEST_TEXT] = "";

    if (reference >= {{ variables|length }}U) {
        append_value(text, "", "value reference", (double)reference, ": no Float64 has it");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    return true;
}

static bool may_be_set({{ name }}_fmu_t *fmu, uint32_t reference, double value)
{
    const {{ name }}_mode_t mode = fmu->memory.mode;

    if (!is_known(fmu, reference)) {
        return false;
    }
    if ((reference < FIRST_INPUT) || (reference >= FIRST_OUTPUT)) {
        return refuse_variable(fmu, reference, ": is computed, and cannot be set");
    }
    if (mode == {{ NAME }}_TERMINATED) {
        return refuse_variable(fmu, reference, ": cannot be set after the end");
    }
    if ((reference >= FIRST_FIXED) && (mode == {{ NAME }}_STEPPING)) {
        return refuse_variable(fmu, reference, ": is fixed once the initialization has ended");
    }
    if ((reference >= FIRST_TUNABLE)
        && !((value >= variables[reference].low) && (value <= variables[reference].high))) {
        return refuse_value(fmu, &variables[reference], value);
    }
    return true;
}

bool {{ name }}_fmu_set({{ name }}_fmu_t *fmu, const uint32_t *references, size_t count,
    const double *values)
{
    {{ name }}_memory_t *m = &fmu->memory;

    for (size_t i = 0U; i < count; i++) {
        if (!may_be_set(fmu, references[i], values[i])) {
            return false;
        }
    }
    for (size_t i = 0U; i < count; i++) {
        m->values[references[i]] = values[i];
        m->is_tuned = m->is_tuned || (references[i] >= FIRST_TUNABLE);
    }
    m->outputs_are_fresh = false;
    return true;
}

/* Compute state and outputs at the start from inputs and parameters. */
static bool start_model({{ name }}_fmu_t *fmu)
{
    {{ name }}_memory_t *m = &fmu->memory;
    {{ name }}_inputs_t in;
    uint16_t status;

    read_parameters(m->values, &m->params);
    read_inputs(m->values, &in);
    status = {{ name }}_init(&m->state, &m->params, &in);
    if (status != {{ NAME }}_OK) {
        return refuse_status(fmu, "the initialization", m->start, status);
    }
    store_results(&m->state.last, m->values);
    m->outputs_are_fresh = true;
    m->is_tuned = false;
    return true;
}

bool {{ name }}_fmu_get({{ name }}_fmu_t *fmu, const uint32_t *references, size_t count, double *values)
{
    {{ name }}_memory_t *m = &fmu->memory;

    for (size_t i = 0U; i < count; i++) {
        const uint32_t reference = references[i];

        if (!is_known(fmu, reference)) {
            return false;
        }
        if ((reference >= FIRST_OUTPUT) && (reference < FIRST_CONSTANT)) {
            if (m->mode == {{ NAME }}_INSTANTIATED) {
                return refuse_variable(fmu, reference, ": has no value before initialization");
            }
            if ((m->mode == {{ NAME }}_INITIALIZING) && !m->outputs_are_fresh && !start_model(fmu)) {
                return false;
            }
        }
        values[i] = m->values[reference];
    }
    return true;
}

/* -------------------------------------------------------------------------------- modes */

static bool is_in({{ name }}_fmu_t *fmu, {{ name }}_mode_t mode, const char *call)
{
    static const char *const modes[] = {
        "instantiated", "in initialization", "initialized", "terminated"};
    char text[LONGEST_TEXT] = "";

    if (fmu->memory.mode == mode) {
        return true;
    }
    append(text, call);
    append(text, ": the instance must be ");
    append(text, modes[mode]);
    append(text, "; it is ");
    append(text, modes[fmu->memory.mode]);
    return {{ name }}_fmu_refuse(fmu, text);
}

bool {{ name }}_fmu_set_times({{ name }}_fmu_t *fmu, double start, bool has_stop, double stop)
{
    {{ name }}_memory_t *m = &fmu->memory;

    if (!is_in(fmu, {{ NAME }}_INSTANTIATED, "start and stop time")) {
        return false;
    }
    if (!isfinite(start) || (has_stop && !(stop >= start))) {
        char text[LONGEST_TEXT] = "";

        append_value(text, "", "start time", start, " s: must be finite, and not after");
        append_value(text, " ", "stop time", has_stop ? stop : HUGE_VAL, " s");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    m->start = start;
    m->stop = has_stop ? stop : HUGE_VAL;
    m->values[0] = start;
    return true;
}

bool {{ name }}_fmu_enter_initialization({{ name }}_fmu_t *fmu)
{
    if (!is_in(fmu, {{ NAME }}_INSTANTIATED, "beginning of the initialization")) {
        return false;
    }
    fmu->memory.mode = {{ NAME }}_INITIALIZING;
    return true;
}

bool {{ name }}_fmu_exit_initialization({{ name }}_fmu_t *fmu)
{
    if (!is_in(fmu, {{ NAME }}_INITIALIZING, "end of the initialization") || !start_model(fmu)) {
        return false;
    }
    fmu->memory.mode = {{ NAME }}_STEPPING;
    return true;
}

bool {{ name }}_fmu_terminate({{ name }}_fmu_t *fmu)
{
    if (!is_in(fmu, {{ NAME }}_STEPPING, "termination")) {
        return false;
    }
    fmu->memory.mode = {{ NAME }}_TERMINATED;
    return true;
}

/* --------------------------------------------------------------------------------- step */

/* Check that a step lies on the grid of sample times; write its number of sample times to ticks. */
static bool is_on_grid({{ name }}_fmu_t *fmu, double point, double size, uint32_t *ticks)
{
    const {{ name }}_memory_t *m = &fmu->memory;
    const double tick = {{ NAME }}_SAMPLE_TIME_S;
    const double expected = m->start + ((double)m->ticks * tick);
    const double counted = size / tick;
    const double rounded = floor(counted + 0.5);
    const double slack = SIZE_SLACK + (1e-15 * ((fabs(point) + fabs(size)) / tick));
    char text[LONGEST_TEXT] = "";

    if (!(fabs(point - expected) <= (POINT_SLACK * tick))) {
        append_value(text, "", "communication point", point, " s");
        append_value(text, ": ", "must be the end of the last step, t", expected, " s");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    if (!((rounded >= 1.0) && (fabs(counted - rounded) <= slack))) {
        append_value(text, "", "communication step", size, " s");
        append_value(text, ": must be a whole multiple of the ", "sample time", tick, " s");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    if (!((point + size) <= (m->stop + (POINT_SLACK * tick)))) {
        append_value(text, "", "end of the step", point + size, " s");
        append_value(text, ": must not be after the ", "stop time", m->stop, " s");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    if (rounded > (double)(UINT32_MAX - m->ticks)) {
        append_value(text, "", "end of the step", point + size, " s");
        append(text, ": must be less than 2^32 sample times after the start");
        return {{ name }}_fmu_refuse(fmu, text);
    }
    *ticks = (uint32_t)rounded;
    return true;
}

{# Copies of state and parameters, because a step that fails must leave the instance as it was. #}
bool {{ name }}_fmu_step({{ name }}_fmu_t *fmu, double point, double size)
{
    {{ name }}_memory_t *m = &fmu->memory;
    {{ name }}_state_t state = m->state;
    {{ name }}_params_t params = m->params;
    {{ name }}_inputs_t in;
    {{ name }}_outputs_t out = m->state.last;
    uint16_t status = {{ NAME }}_OK;
    uint32_t ticks = 0U;
    uint32_t i;

    if (!is_in(fmu, {{ NAME }}_STEPPING, "step") || !is_on_grid(fmu, point, size, &ticks)) {
        return false;
    }
    if (m->is_tuned) {
        read_parameters(m->values, &params);
        status = {{ name }}_update_parameters(&state, &params);
        if (status != {{ NAME }}_OK) {
            return refuse_status(fmu, "the change of parameters", point, status);
        }
    }
    read_inputs(m->values, &in);
    for (i = 0U; i < ticks; i++) {
        status = {{ name }}_step(&params, &state, &in, &out);
        if (status != {{ NAME }}_OK) {
            const double time = m->start + (((double)m->ticks + (double)i) * {{ NAME }}_SAMPLE_TIME_S);

{% if accepts_inputs %}
            m->state.started = state.started; /* a failed model needs a new start */
{% endif %}
            return refuse_status(fmu, "the step", time, status);
        }
    }
    m->state = state;
    m->params = params;
    m->is_tuned = false;
    m->ticks += ticks;
    m->values[0] = m->start + ((double)m->ticks * {{ NAME }}_SAMPLE_TIME_S);
    store_results(&out, m->values);
    return true;
}

/* ------------------------------------------------------------------------- saved states */

bool {{ name }}_fmu_save({{ name }}_fmu_t *fmu, void **saved)
{
    if (*saved == NULL) {
        *saved = malloc(sizeof fmu->memory);
    }
    if (*saved == NULL) {
        return {{ name }}_fmu_refuse(fmu, "out of memory");
    }
    (void)memcpy(*saved, &fmu->memory, sizeof fmu->memory);
    return true;
}

bool {{ name }}_fmu_restore({{ name }}_fmu_t *fmu, const void *saved)
{
    if (saved == NULL) {
        return {{ name }}_fmu_refuse(fmu, "saved state: there is none");
    }
    (void)memcpy(&fmu->memory, saved, sizeof fmu->memory);
    return true;
}

size_t {{ name }}_fmu_serialized_size(void)
{
    return sizeof({{ NAME }}_TOKEN) + sizeof({{ name }}_memory_t);
}

static bool has_size({{ name }}_fmu_t *fmu, size_t size)
{
    char text[LONGEST_TEXT] = "";

    if (size == {{ name }}_fmu_serialized_size()) {
        return true;
    }
    append_value(text, "serialized state: ", "size", (double)size, " bytes");
    append_value(text, ", must be ", "that of this FMU", (double){{ name }}_fmu_serialized_size(),
        " bytes");
    return {{ name }}_fmu_refuse(fmu, text);
}

bool {{ name }}_fmu_serialize({{ name }}_fmu_t *fmu, const void *saved, void *bytes, size_t size)
{
    unsigned char *to = bytes;

    if (!has_size(fmu, size)) {
        return false;
    }
    (void)memcpy(to, {{ NAME }}_TOKEN, sizeof({{ NAME }}_TOKEN));
    (void)memcpy(&to[sizeof({{ NAME }}_TOKEN)], saved, sizeof({{ name }}_memory_t));
    return true;
}

bool {{ name }}_fmu_deserialize({{ name }}_fmu_t *fmu, const void *bytes, size_t size, void **saved)
{
    const unsigned char *from = bytes;

    if (!has_size(fmu, size)) {
        return false;
    }
    if (memcmp(from, {{ NAME }}_TOKEN, sizeof({{ NAME }}_TOKEN)) != 0) {
        return {{ name }}_fmu_refuse(fmu, "serialized state: is of another FMU");
    }
    if (*saved == NULL) {
        *saved = malloc(sizeof({{ name }}_memory_t));
    }
    if (*saved == NULL) {
        return {{ name }}_fmu_refuse(fmu, "out of memory");
    }
    (void)memcpy(*saved, &from[sizeof({{ NAME }}_TOKEN)], sizeof({{ name }}_memory_t));
    return true;
}
