/* Start of a Cortex-M program under QEMU: vectors, the FPU, memory, then main. */
#include <stdint.h>
#include <stdio.h>
#include <unistd.h>

extern uint32_t stack_top[], data_load[], data_start[], data_end[], bss_start[], bss_end[];

extern int main(void);
extern void initialise_monitor_handles(void); /* of newlib's semihosting */

void reset(void);
void fault(void);

void reset(void)
{
    volatile uint32_t *const coprocessor_access = (volatile uint32_t *)0xE000ED88U;

    *coprocessor_access |= 0xFU << 20; /* full access to the FPU */
    __asm__ volatile("dsb\n\tisb" ::: "memory");
    for (uint32_t *to = data_start, *from = data_load; to < data_end; to++, from++) {
        *to = *from;
    }
    for (uint32_t *to = bss_start; to < bss_end; to++) {
        *to = 0U;
    }
    initialise_monitor_handles();
    const int status = main();
    fflush(NULL);
    _exit(status);
}

void fault(void)
{
    _exit(3);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    stack_top, reset, fault, fault, fault, fault, fault,
};
