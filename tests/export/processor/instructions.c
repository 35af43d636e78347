/* Prints how many instructions a step takes: mean and largest over the test vectors.
 *
 * QEMU with -icount shift=6 counts 64 ns an instruction, and SysTick runs at the 25 MHz of the
 * board: 1.6 ticks an instruction. What two readings of SysTick alone take is subtracted. */
#include MODEL_VECTORS

#include <stdint.h>
#include <stdio.h>

#define TICKS_PER_INSTRUCTION 1.6
#define SYSTICK ((volatile uint32_t *)0xE000E010U) /* control, reload, current value */
#define LARGEST 0xFFFFFFU

static uint32_t elapsed(uint32_t start)
{
    return (start - SYSTICK[2]) & LARGEST; /* it counts down */
}

int main(void)
{
    static MODEL(state_t) state;
    MODEL(outputs_t) outputs;
    uint32_t largest = 0U;
    double total = 0.0;
    uint16_t status = MODEL(init)(&state, &MODEL(params), &MODEL(vectors)[0].inputs);

    SYSTICK[1] = LARGEST;
    SYSTICK[2] = 0U;
    SYSTICK[0] = 5U; /* on, with the clock of the processor */
    for (uint32_t k = 0U; k < VECTORS; k++) {
        uint32_t start = SYSTICK[2];
        const uint32_t reading = elapsed(start);
        uint32_t ticks;

        start = SYSTICK[2];
        status |= MODEL(step)(&MODEL(params), &state, &MODEL(vectors)[k].inputs, &outputs);
        ticks = elapsed(start) - reading;
        total += ticks;
        largest = (ticks > largest) ? ticks : largest;
    }
    printf("status %u, mean %.1f, largest %.1f instructions a step\n", (unsigned)status,
        total / VECTORS / TICKS_PER_INSTRUCTION, largest / TICKS_PER_INSTRUCTION);
    return (status == 0U) ? 0 : 1;
}
