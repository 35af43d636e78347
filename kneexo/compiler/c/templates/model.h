#ifndef UPPER_H
#define UPPER_H

#include <float.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

@if double
#if DBL_MANT_DIG < 53
#error "double has fewer than 53 bits here: export single precision"
#endif

@end
typedef REAL NAME_real_t;

#define UPPER_SAMPLE_TIME_S @{sample_time}

/* Status of a call: 0, or the sum of what went wrong. After a failed step the state is as it was
 * before, and the outputs are the last ones that were right; without a start they are zero. */
#define UPPER_OK 0U
#define UPPER_BAD_INPUT 1U /* an input is not finite, or out of its range */
#define UPPER_BAD_RESULT 2U /* a result is not finite */
@if limits
#define UPPER_OUT_OF_LIMITS 4U /* a leaf system left its limits */
@end
#define UPPER_NOT_STARTED 8U /* NAME_init has not succeeded yet */
#define UPPER_BAD_PARAMETER 16U /* a parameter or a start value is not finite */

/* Context parameters of the leaf systems, in SI units, and the start. */
typedef struct {
@parameters
} NAME_params_t;

typedef struct {
@inputs
} NAME_inputs_t;

typedef struct {
@outputs
} NAME_outputs_t;

typedef struct {
@state
    NAME_outputs_t last; /* the last outputs that were right */
@if ticks
    uint32_t tick; /* @{tick_meaning} */
@end
    uint32_t started; /* 1 after NAME_init has succeeded, else 0 */
} NAME_state_t;

extern const NAME_params_t NAME_params;

@if tables
/* What follows from a whole-number input alone, computed when this was exported. Parameters that
 * were used only for that act no more. */
@tables

@end
/* Start anew; the inputs are those of the first step. After a failure the model is not started:
 * steps and outputs are refused until NAME_init succeeds. */
uint16_t NAME_init(NAME_state_t *state, const NAME_params_t *params,
    const NAME_inputs_t *inputs);

/* To be called when parameters have changed; the state is kept. Change a second struct, call this,
 * and use that struct for the steps only after status 0: after a failure the state still has what
 * followed from the parameters before. */
uint16_t NAME_update_parameters(NAME_state_t *state, const NAME_params_t *params);

/* Go over one sample time. */
uint16_t NAME_step(const NAME_params_t *params, NAME_state_t *state,
    const NAME_inputs_t *inputs, NAME_outputs_t *outputs);

/* The outputs at the present state and these inputs, without a step. */
uint16_t NAME_outputs(const NAME_params_t *params, const NAME_state_t *state,
    const NAME_inputs_t *inputs, NAME_outputs_t *outputs);

#ifdef __cplusplus
}
#endif

#endif
