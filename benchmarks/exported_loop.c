/* The closed loop of an exported controller, which reads counts, and an exported plant. */
#include "controller.h"
#include "plant.h"

#include <math.h>

/* Record k is the plant at the k-th sample, and the command that follows from it. Returns the first
 * sample whose status is not 0; the number of samples when there is none. */
uint32_t closed_loop(const controller_params_t *controller_params, const plant_params_t *params,
    double resolution_rad, uint32_t samples, controller_inputs_t *inputs,
    controller_outputs_t *commands, plant_outputs_t *outputs)
{
    controller_state_t controller;
    plant_state_t plant;
    plant_inputs_t plant_inputs = {0.0};

    if (plant_init(&plant, params, &plant_inputs) != 0U) {
        return 0U;
    }
    outputs[0] = plant.last;
    for (uint32_t k = 0U; k < samples; k++) {
        inputs[k].encoder_count = (int32_t)lround(outputs[k].encoder_reading_rad / resolution_rad);
        if ((k == 0U) && (controller_init(&controller, controller_params, inputs) != 0U)) {
            return 0U;
        }
        if (controller_step(controller_params, &controller, &inputs[k], &commands[k]) != 0U) {
            return k;
        }
        plant_inputs.motor_speed_command_rad_s = (double)commands[k].motor_speed_command_rad_s;
        if ((k + 1U < samples)
            && (plant_step(params, &plant, &plant_inputs, &outputs[k + 1U]) != 0U)) {
            return k + 1U;
        }
    }
    return samples;
}
