/* Calls an exported controller with rows of inputs; -D'FIELDS=IN(type, name) ...' lists the inputs.
 * A row has 1.0 where a start precedes the step, or 0.0, and the inputs. The row of results has the
 * sum of the statuses of controller_init and controller_outputs, that of controller_step, and the
 * outputs of the step. */
#include <stdio.h>

#include "controller.h"

#define IN(type, name) +1
enum { INPUTS = FIELDS, OUTPUTS = sizeof(controller_outputs_t) / sizeof(controller_real_t) };
#undef IN
#define IN(type, name) in.name = (type)row[place++];

int main(void)
{
    static controller_state_t state;
    double row[1 + INPUTS];
    double found[2 + OUTPUTS];

    while (fread(row, sizeof row, 1, stdin) == 1) {
        controller_inputs_t in;
        controller_outputs_t out;
        const controller_real_t *values = (const controller_real_t *)&out;
        int place = 1;

        FIELDS
        found[0] = 0.0;
        if (row[0] > 0.0) {
            found[0] += (double)controller_init(&state, &controller_params, &in);
        }
        found[0] += (double)controller_outputs(&controller_params, &state, &in, &out);
        found[1] = (double)controller_step(&controller_params, &state, &in, &out);
        for (int i = 0; i < OUTPUTS; i++) {
            found[2 + i] = (double)values[i];
        }
        if (fwrite(found, sizeof found, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
