/* Runs an FMU for co-simulation and prints its outputs.
 *
 * driver LIBRARY VERSION TOKEN STEP_S STEPS INPUTS FIRST_OUTPUT OUTPUTS
 *
 * The value references of the inputs are 1 … INPUTS. In step n, input i is k / 64, where k is
 * (7 n + 3 i) mod 17 - 8. A line holds the outputs after a step, with all digits.
 */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#ifdef _WIN32
#include <windows.h>
static void *open_library(const char *path)
{
    return (void *)LoadLibraryA(path);
}
static void *symbol_of(void *library, const char *name)
{
    return (void *)GetProcAddress((HMODULE)library, name);
}
#else
#include <dlfcn.h>
static void *open_library(const char *path)
{
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}
static void *symbol_of(void *library, const char *name)
{
    return dlsym(library, name);
}
#endif

#define MOST 64

typedef void *(*instantiate2_t)(
    const char *, int, const char *, const char *, const void *, int, int);
typedef void *(*instantiate3_t)(const char *, const char *, const char *, bool, bool, bool, bool,
    const uint32_t *, size_t, void *, void *, void *);
typedef int (*setup2_t)(void *, int, double, double, int, double);
typedef int (*call_t)(void *);
typedef int (*enter3_t)(void *, bool, double, double, bool, double);
typedef int (*values2_t)(void *, const unsigned int *, size_t, double *);
typedef int (*values3_t)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*step2_t)(void *, double, double, int);
typedef int (*step3_t)(void *, double, double, bool, bool *, bool *, bool *, double *);

static void *library;
static int version;

static void *function(const char *name)
{
    char full[80];
    void *address;

    snprintf(full, sizeof full, "fmi%d%s", version, name);
    address = symbol_of(library, full);
    if (address == NULL) {
        fprintf(stderr, "%s is missing\n", full);
        exit(3);
    }
    return address;
}

static void require(int status, const char *call)
{
    if (status != 0) {
        fprintf(stderr, "%s: status %d\n", call, status);
        exit(4);
    }
}

static void exchange(void *instance, const char *two, const char *three, uint32_t first,
    size_t count, double *values)
{
    uint32_t references[MOST];

    for (uint32_t i = 0; i < count; i++) {
        references[i] = first + i;
    }
    if (version == 2) {
        require(((values2_t)function(two))(instance, references, count, values), two);
    } else {
        require(((values3_t)function(three))(instance, references, count, values, count), three);
    }
}

static void *started(const char *token)
{
    void *instance;

    if (version == 2) {
        instance = ((instantiate2_t)function("Instantiate"))("a", 1, token, "", NULL, 0, 0);
    } else {
        instance = ((instantiate3_t)function("InstantiateCoSimulation"))(
            "a", token, "", false, false, false, false, NULL, 0, NULL, NULL, NULL);
    }
    require(instance == NULL, "Instantiate");
    if (version == 2) {
        require(((setup2_t)function("SetupExperiment"))(instance, 0, 0.0, 0.0, 0, 0.0), "Setup");
        require(((call_t)function("EnterInitializationMode"))(instance), "Enter");
    } else {
        require(((enter3_t)function("EnterInitializationMode"))(
                    instance, false, 0.0, 0.0, false, 0.0),
            "Enter");
    }
    require(((call_t)function("ExitInitializationMode"))(instance), "Exit");
    return instance;
}

static void step(void *instance, double time, double size)
{
    bool flags[3];
    double last;

    if (version == 2) {
        require(((step2_t)function("DoStep"))(instance, time, size, 0), "DoStep");
    } else {
        require(((step3_t)function("DoStep"))(
                    instance, time, size, false, &flags[0], &flags[1], &flags[2], &last),
            "DoStep");
    }
}

int main(int count, char **arguments)
{
    if (count != 9) {
        return 2;
    }
    library = open_library(arguments[1]);
    if (library == NULL) {
        fprintf(stderr, "%s cannot be loaded\n", arguments[1]);
        return 3;
    }
    version = atoi(arguments[2]);

    const double size = strtod(arguments[4], NULL);
    const int steps = atoi(arguments[5]);
    const int inputs = atoi(arguments[6]);
    const int first_output = atoi(arguments[7]);
    const int outputs = atoi(arguments[8]);
    double values[MOST];
    void *instance;

    if (inputs > MOST || outputs > MOST) {
        return 2;
    }
    instance = started(arguments[3]);
    for (int n = 0; n < steps; n++) {
        for (int i = 0; i < inputs; i++) {
            values[i] = ((7 * n + 3 * (i + 1)) % 17 - 8) / 64.0;
        }
        exchange(instance, "SetReal", "SetFloat64", 1, (size_t)inputs, values);
        step(instance, n * size, size);
        exchange(instance, "GetReal", "GetFloat64", (uint32_t)first_output, (size_t)outputs, values);
        for (int i = 0; i < outputs; i++) {
            printf("%.17g ", values[i]);
        }
        printf("\n");
    }
    return 0;
}
