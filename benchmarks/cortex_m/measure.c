/* What a step of an exported model takes: instructions and stack. -DHEADER="NAME_vectors.h",
 * -D'OF(x)=NAME_##x', -DVECTORS=NAME_VECTORS.
 *
 * QEMU with -icount shift=6 counts 64 ns an instruction, and SysTick runs at the 25 MHz of the
 * board: 1.6 ticks an instruction. What two readings of SysTick alone take is subtracted. */
#include HEADER

#include <stdio.h>

#define TICKS_PER_INSTRUCTION 1.6
#define SYSTICK ((volatile uint32_t *)0xE000E010U) /* control, reload, current value */
#define LARGEST 0xFFFFFFU
#define PAINTED 2048 /* words of stack */
#define PAINT 0xA5A5A5A5U

static OF(state_t) state;
static OF(outputs_t) outputs;

static uint32_t elapsed(uint32_t start)
{
    return (start - SYSTICK[2]) & LARGEST; /* it counts down */
}

static double instructions(uint32_t ticks, uint32_t reading)
{
    return (double)(ticks - reading) / TICKS_PER_INSTRUCTION;
}

static void hundred(void)
{
    __asm__ volatile(".rept 100\n\tnop\n\t.endr");
}

__attribute__((noinline)) static uint32_t stack_of_steps(void)
{
    volatile uint32_t *top;
    uint32_t words = PAINTED;

    __asm__ volatile("mov %0, sp" : "=r"(top));
    for (int32_t i = 1; i <= PAINTED; i++) {
        top[-i] = PAINT;
    }
    for (uint32_t k = 0U; k < VECTORS; k++) {
        (void)OF(step)(&OF(params), &state, &OF(vectors)[k].inputs, &outputs);
    }
    while ((words > 0U) && (top[-(int32_t)words] == PAINT)) {
        words--;
    }
    return 4U * words;
}

int main(void)
{
    uint32_t largest = 0U;
    uint32_t reading;
    uint32_t start;
    double total = 0.0;
    uint16_t status = OF(init)(&state, &OF(params), &OF(vectors)[0].inputs);

    SYSTICK[1] = LARGEST;
    SYSTICK[2] = 0U;
    SYSTICK[0] = 5U; /* on, with the clock of the processor */
    start = SYSTICK[2];
    reading = elapsed(start);
    start = SYSTICK[2];
    hundred();
    printf("a hundred: %.1f instructions\n", instructions(elapsed(start), reading));
    for (uint32_t k = 0U; k < VECTORS; k++) {
        uint32_t ticks;

        start = SYSTICK[2];
        status |= OF(step)(&OF(params), &state, &OF(vectors)[k].inputs, &outputs);
        ticks = elapsed(start);
        total += instructions(ticks, reading);
        largest = (ticks > largest) ? ticks : largest;
    }
    printf("mean: %.1f instructions\n", total / VECTORS);
    printf("largest: %.1f instructions\n", instructions(largest, reading));
    printf("stack: %lu bytes\n", (unsigned long)stack_of_steps());
    printf("state: %lu bytes\n", (unsigned long)(sizeof state + sizeof outputs));
    return (status == 0U) ? 0 : 1;
}
