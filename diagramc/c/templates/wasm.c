/* Runs many ticks of the model {{ name }} in a call, for a host of WebAssembly. */
#include "{{ name }}.h"

#define INPUTS {{ inputs | length }}U
#define OUTPUTS {{ outputs | length }}U
#define PAGE 65536U /* bytes of a page of memory in WebAssembly */
#define EXPORTED(name) __attribute__((export_name(name)))

/* The host reads and writes these structs as vectors of doubles, see the table of the module. */
_Static_assert(sizeof({{ name }}_params_t) == {{ params }}U * sizeof(double), "padding");
_Static_assert(sizeof({{ name }}_outputs_t) == (OUTPUTS ? OUTPUTS : 1U) * sizeof(double), "padding");

extern unsigned char __heap_base; /* the linker places it behind the stack and the static data */

static {{ name }}_params_t params;
static {{ name }}_state_t state;
static double *recorded; /* columns of all inputs, then of all outputs */
static uint32_t rows;
static uint32_t last_status = {{ NAME }}_NOT_STARTED;

{% if inputs | selectattr("is_integer") | list %}
/* Return the number of a count; a value that no int32_t has becomes the smallest one. */
static int32_t count_of(double value)
{
    return ((value >= (double)INT32_MIN) && (value <= (double)INT32_MAX)) ? (int32_t)value : INT32_MIN;
}

{% endif %}
static {{ name }}_inputs_t inputs_at(uint32_t row)
{
    {{ name }}_inputs_t in;

{% for field in inputs %}
    in.{{ field.name }} = {{ "count_of(" if field.is_integer }}recorded[{{ loop.index0 }}U * rows + row]{{ ")" if field.is_integer }};
{% else %}
    (void)row;
    in.none = 0.0;
{% endfor %}
    return in;
}

static void record(uint32_t row, const {{ name }}_outputs_t *out)
{
    const double *values = (const double *)out;

    for (uint32_t column = 0U; column < OUTPUTS; column++) {
        recorded[(INPUTS + column) * rows + row] = values[column];
    }
}

/* Set the parameters and the initial states to those of the export. */
EXPORTED("defaults") void {{ name }}_web_defaults(void)
{
    params = {{ name }}_params;
}

EXPORTED("params") double *{{ name }}_web_params(void)
{
    return (double *)&params;
}

{# No malloc: the rows are the only memory that a run requires, and lie behind the heap base. #}
/* Provide rows for the inputs and outputs of a run of this many ticks: 1, or 0 without memory. */
EXPORTED("reserve") uint32_t {{ name }}_web_reserve(uint32_t ticks)
{
    const uint64_t start = ((uint64_t)(uintptr_t)&__heap_base + 15U) & ~(uint64_t)15U;
    const uint64_t end = start + ((uint64_t)ticks + 1U) * (INPUTS + OUTPUTS) * sizeof(double);
    const uint64_t pages = (end + PAGE - 1U) / PAGE;
    const uint64_t present = __builtin_wasm_memory_size(0);

    rows = 0U;
    last_status = {{ NAME }}_NOT_STARTED;
    if (pages > present) {
        if ((pages > PAGE) || (__builtin_wasm_memory_grow(0, pages - present) == (size_t)-1)) {
            return 0U;
        }
    }
    recorded = (double *)(uintptr_t)start;
    rows = ticks + 1U;
    for (uint64_t i = 0U; i < (uint64_t)rows * INPUTS; i++) {
        recorded[i] = 0.0;
    }
    return 1U;
}

EXPORTED("inputs") double *{{ name }}_web_inputs(void)
{
    return recorded;
}

EXPORTED("outputs") double *{{ name }}_web_outputs(void)
{
    return recorded + INPUTS * rows;
}

/* The continuous states, then the discrete ones. */
EXPORTED("states") double *{{ name }}_web_states(void)
{
    return (double *)&state;
}

/* Start the model with the inputs of row 0; the status is 0 for success. */
EXPORTED("start") uint32_t {{ name }}_web_start(void)
{
    last_status = {{ NAME }}_NOT_STARTED;
    if (rows > 0U) {
        const {{ name }}_inputs_t in = inputs_at(0U);

        last_status = {{ name }}_init(&state, &params, &in);
    }
    if (last_status == {{ NAME }}_OK) {
        record(0U, &state.last);
{% if failing %}
    } else if (rows > 0U) {
        const {{ name }}_inputs_t in = inputs_at(0U);
        {{ name }}_outputs_t out;

        (void){{ name }}_outputs(&params, &state, &in, &out);
        record(0U, &out); /* the outputs of a failure */
{% endif %}
    }
    return last_status;
}

/* Step the ticks from … from + ticks - 1; return how many steps succeeded. */
EXPORTED("advance") uint32_t {{ name }}_web_advance(uint32_t from, uint32_t ticks)
{
    {{ name }}_outputs_t out;
    uint32_t good = 0U;

    while ((good < ticks) && (last_status == {{ NAME }}_OK) && ((uint64_t)from + good + 1U < rows)) {
        const {{ name }}_inputs_t in = inputs_at(from + good);

        last_status = {{ name }}_step(&params, &state, &in, &out);
        if (last_status == {{ NAME }}_OK) {
            good++;
            record(from + good, &out);
{% if failing %}
        } else {
            record(from + good + 1U, &out); /* the outputs of a failure */
{% endif %}
        }
    }
    return good;
}

EXPORTED("status") uint32_t {{ name }}_web_status(void)
{
    return last_status;
}
