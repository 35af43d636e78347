/* Steps an exported model: -DHEADER="NAME.h" -D'OF(x)=NAME_##x'. */
#include HEADER

/* Outputs at the start and after each step. Returns the first step whose status is not 0; the number
 * of steps when there is none. */
uint32_t replay(const OF(params_t) *params, const OF(inputs_t) *inputs, uint32_t steps,
    OF(outputs_t) *outputs)
{
    OF(state_t) state;

    if (OF(init)(&state, params, inputs) != 0U) {
        return 0U;
    }
    outputs[0] = state.last;
    for (uint32_t k = 0U; k < steps; k++) {
        if (OF(step)(params, &state, &inputs[k], &outputs[k + 1U]) != 0U) {
            return k;
        }
    }
    return steps;
}
