/* Steps an exported controller with sane, odd and impossible inputs: -DHEADER="NAME.h"
 * -D'OF(x)=NAME_##x' -DSTEPS=... -DLIMIT=..., the largest command. fields.h lists the inputs as
 * COUNT(name, lowest, highest),
 * RANGE(name, lowest, highest) and REAL(name). Ends with 1 at the first step that breaks a rule:
 *
 * - An input that is not finite or out of its range gives BAD_INPUT.
 * - Any status but 0 leaves the state as it was, bit by bit, and commands zero.
 * - After it, a sane input gives 0 again, and what a twin gives that never saw the bad ones.
 * - Outputs are finite and within the limit. */
#include HEADER

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(rule)                                                                               \
    do {                                                                                          \
        if (!(rule)) {                                                                            \
            printf("step %lu, status %u: not " #rule "\n", (unsigned long)k, (unsigned)status);   \
            exit(1);                                                                              \
        }                                                                                         \
    } while (0)

static uint64_t noise = 88172645463325252U;

static uint32_t below(uint32_t count)
{
    noise ^= noise << 13;
    noise ^= noise >> 7;
    noise ^= noise << 17;
    return (uint32_t)((noise >> 16) % count);
}

static double sane(void)
{
    return ((double)below(2000001U) - 1e6) / 1e6;
}

static OF(real_t) odd(void)
{
    OF(real_t) value = (OF(real_t))0;
    uint64_t bits;

    switch (below(12U)) {
    case 0: return (OF(real_t))NAN;
    case 1: return (OF(real_t))INFINITY;
    case 2: return -(OF(real_t))INFINITY;
    case 3: return (OF(real_t))LARGEST;
    case 4: return -(OF(real_t))LARGEST;
    case 5: return (OF(real_t))(SMALLEST / 4.0); /* denormal */
    case 6: return -value;
    case 7:
    case 8:
        (void)below(1U);
        bits = noise;
        memcpy(&value, &bits, sizeof value);
        return value;
    default: return (OF(real_t))sane();
    }
}

static int32_t odd_count(int32_t low, int32_t high)
{
    const int32_t edges[] = {INT32_MIN, INT32_MAX, low - 1, low, high, high + 1, 0};
    const uint32_t chosen = below(8U);

    (void)below(1U);
    return (chosen < 7U) ? edges[chosen] : (int32_t)(uint32_t)noise;
}

static bool is_right(const OF(inputs_t) *in)
{
    bool right = true;

#define COUNT(name, low, high) right = right && (in->name >= (low)) && (in->name <= (high));
#define RANGE(name, low, high)                                                                    \
    right = right && (in->name >= (OF(real_t))(low)) && (in->name <= (OF(real_t))(high));
#define REAL(name) right = right && isfinite(in->name);
#include "fields.h"
#undef COUNT
#undef RANGE
#undef REAL
    return right;
}

static OF(inputs_t) drawn(bool all_sane)
{
    OF(inputs_t) in;

#define COUNT(name, low, high)                                                                    \
    in.name = all_sane ? (low) + (int32_t)below((uint32_t)((high) - (low) + 1))                   \
                       : odd_count((low), (high));
#define RANGE(name, low, high)                                                                    \
    in.name = all_sane ? (OF(real_t))((low) + (0.5 * (1.0 + sane()) * ((high) - (low)))) : odd();
#define REAL(name) in.name = all_sane ? (OF(real_t))sane() : odd();
#include "fields.h"
#undef COUNT
#undef RANGE
#undef REAL
    return in;
}

int main(void)
{
    unsigned long counts[3] = {0UL, 0UL, 0UL};
    OF(state_t) state;
    OF(state_t) before;
    OF(state_t) twin;
    OF(outputs_t) outputs;
    OF(outputs_t) of_twin;
    OF(inputs_t) in = drawn(true);
    uint32_t k = 0U;
    uint16_t status = OF(init)(&state, &OF(params), &in);

    CHECK(status == 0U);
    memcpy(&twin, &state, sizeof state);
    for (k = 0U; k < STEPS; k++) {
        const bool all_sane = below(2U) == 0U;

        in = drawn(all_sane);
        memcpy(&before, &state, sizeof state);
        status = OF(step)(&OF(params), &state, &in, &outputs);
        CHECK(status <= 2U);
        counts[status]++;
        CHECK((status == 1U) == !is_right(&in));
        CHECK(!all_sane || (status == 0U));
        CHECK(fabs((double)outputs.motor_speed_command_rad_s) <= LIMIT);
        if (status == 0U) {
            CHECK(OF(step)(&OF(params), &twin, &in, &of_twin) == 0U);
            CHECK(memcmp(&of_twin, &outputs, sizeof outputs) == 0);
        } else {
            CHECK(memcmp(&before, &state, sizeof state) == 0);
            CHECK(outputs.motor_speed_command_rad_s == (OF(real_t))0);
        }
    }
    printf("%lu right, %lu bad inputs, %lu bad results\n", counts[0], counts[1], counts[2]);
    return 0;
}
