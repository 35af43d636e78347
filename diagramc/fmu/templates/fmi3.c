{% extends "fmi.c" %}
{% set fmi, instance = 3, "instance" %}
{% set State, Deserialize, byte = "State", "Deserialize", "uint8_t" %}
{% block types %}
typedef void (*logger_t)(void *environment, status_t status, const char *category,
    const char *message);

typedef struct {
    {{ name }}_fmu_t fmu;
    logger_t logger;
    void *environment;
} instance_t;

{% endblock %}
{% block report %}
static void report(void *owner, const char *text)
{
    const instance_t *instance = owner;

    if (instance->logger != NULL) {
        instance->logger(instance->environment, FMI3_ERROR, "logStatusError", text);
    }
}

{% endblock %}
{% block start %}
EXPORT const char *FMI(GetVersion)(void)
{
    return "3.0";
}

/* Errors are always reported, and there is nothing else to report. */
EXPORT status_t FMI(SetDebugLogging)(void *instance, bool on, size_t count,
    const char *const *categories)
{
    (void)instance;
    (void)on;
    (void)count;
    (void)categories;
    return FMI3_OK;
}

EXPORT void FMI(FreeInstance)(void *instance)
{
    free(instance);
}

EXPORT void *FMI(InstantiateCoSimulation)(const char *name, const char *token,
    const char *resources, bool visible, bool logging, bool uses_events, bool may_return_early,
    const uint32_t *intermediate, size_t intermediate_count, void *environment, logger_t logger,
    void (*update)(void *environment, double time, bool set_requested, bool get_allowed,
        bool step_finished, bool can_return_early, bool *early_requested, double *early_time))
{
    const char *wrong = NULL;
    instance_t *instance = calloc(1U, sizeof *instance);

    (void)resources;
    (void)visible;
    (void)logging;
    (void)may_return_early;
    (void)intermediate;
    (void)update;
    if (instance == NULL) {
        return NULL;
    }
    instance->logger = logger;
    instance->environment = environment;
    instance->fmu.report = report;
    instance->fmu.owner = instance;
    if ((name == NULL) || (name[0] == '\0')) {
        wrong = "instance name: must not be empty";
    } else if ((token == NULL) || (strcmp(token, {{ NAME }}_TOKEN) != 0)) {
        wrong = "instantiation token: must be " {{ NAME }}_TOKEN ", that of this FMU";
    } else if (uses_events) {
        wrong = "event mode: this FMU has none";
    } else if (intermediate_count != 0U) {
        wrong = "intermediate variables: this FMU has none";
    }
    if (wrong != NULL) {
        report(instance, wrong);
        FMI(FreeInstance)(instance);
        return NULL;
    }
    {{ name }}_fmu_reset(&instance->fmu);
    return instance;
}

EXPORT void *FMI(InstantiateModelExchange)(const char *name, const char *token,
    const char *resources, bool visible, bool logging, void *environment, logger_t logger)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    if (logger != NULL) {
        logger(environment, FMI3_ERROR, "logStatusError", "this FMU is for co-simulation only");
    }
    return NULL;
}

EXPORT void *FMI(InstantiateScheduledExecution)(const char *name, const char *token,
    const char *resources, bool visible, bool logging, void *environment, logger_t logger,
    void (*clock_update)(void *environment), void (*lock)(void), void (*unlock)(void))
{
    (void)clock_update;
    (void)lock;
    (void)unlock;
    return FMI(InstantiateModelExchange)(name, token, resources, visible, logging, environment,
        logger);
}

/* The integrator has steps of a fixed size: a tolerance changes nothing. */
EXPORT status_t FMI(EnterInitializationMode)(void *instance, bool has_tolerance, double tolerance,
    double start, bool has_stop, double stop)
{
    {{ name }}_fmu_t *fmu = fmu_of(instance);

    (void)has_tolerance;
    (void)tolerance;
    return status_of({{ name }}_fmu_set_times(fmu, start, has_stop, stop)
        && {{ name }}_fmu_enter_initialization(fmu));
}

{% endblock %}
{% block values %}
/* ------------------------------------------------------------------------------- values */

EXPORT status_t FMI(GetFloat64)(void *instance, const uint32_t *references, size_t count,
    double *values, size_t value_count)
{
    if (value_count != count) {
        return refuse(instance, "GetFloat64: all variables are scalar, give as many values");
    }
    return status_of({{ name }}_fmu_get(fmu_of(instance), references, count, values));
}

EXPORT status_t FMI(SetFloat64)(void *instance, const uint32_t *references, size_t count,
    const double *values, size_t value_count)
{
    if (value_count != count) {
        return refuse(instance, "SetFloat64: all variables are scalar, give as many values");
    }
    return status_of({{ name }}_fmu_set(fmu_of(instance), references, count, values));
}

#define NO_VARIABLES(call, type) \
    EXPORT status_t FMI(call)(void *instance, const uint32_t *references, size_t count, \
        type values, size_t value_count) \
    { \
        (void)references; \
        (void)values; \
        (void)value_count; \
        return refuse_any(instance, count, #call ": this FMU has Float64 variables only"); \
    }

NO_VARIABLES(GetFloat32, float *)
NO_VARIABLES(SetFloat32, const float *)
NO_VARIABLES(GetInt8, int8_t *)
NO_VARIABLES(SetInt8, const int8_t *)
NO_VARIABLES(GetUInt8, uint8_t *)
NO_VARIABLES(SetUInt8, const uint8_t *)
NO_VARIABLES(GetInt16, int16_t *)
NO_VARIABLES(SetInt16, const int16_t *)
NO_VARIABLES(GetUInt16, uint16_t *)
NO_VARIABLES(SetUInt16, const uint16_t *)
NO_VARIABLES(GetInt32, int32_t *)
NO_VARIABLES(SetInt32, const int32_t *)
NO_VARIABLES(GetUInt32, uint32_t *)
NO_VARIABLES(SetUInt32, const uint32_t *)
NO_VARIABLES(GetInt64, int64_t *)
NO_VARIABLES(SetInt64, const int64_t *)
NO_VARIABLES(GetUInt64, uint64_t *)
NO_VARIABLES(SetUInt64, const uint64_t *)
NO_VARIABLES(GetBoolean, bool *)
NO_VARIABLES(SetBoolean, const bool *)
NO_VARIABLES(GetString, const char **)
NO_VARIABLES(SetString, const char *const *)

#define NO_BINARIES(call, size_type, type) \
    EXPORT status_t FMI(call)(void *instance, const uint32_t *references, size_t count, \
        size_type sizes, type values, size_t value_count) \
    { \
        (void)references; \
        (void)sizes; \
        (void)values; \
        (void)value_count; \
        return refuse_any(instance, count, #call ": this FMU has Float64 variables only"); \
    }

NO_BINARIES(GetBinary, size_t *, const uint8_t **)
NO_BINARIES(SetBinary, const size_t *, const uint8_t *const *)

#define NO_CLOCKS(call, type) \
    EXPORT status_t FMI(call)(void *instance, const uint32_t *references, size_t count, \
        type values) \
    { \
        (void)references; \
        (void)values; \
        return refuse_any(instance, count, #call ": this FMU has no clocks"); \
    }

NO_CLOCKS(GetClock, bool *)
NO_CLOCKS(SetClock, const bool *)
NO_CLOCKS(GetShiftDecimal, double *)
NO_CLOCKS(SetShiftDecimal, const double *)
NO_CLOCKS(SetIntervalDecimal, const double *)

#define NO_INTERVALS(call, first_type, second_type) \
    EXPORT status_t FMI(call)(void *instance, const uint32_t *references, size_t count, \
        first_type first, second_type second) \
    { \
        (void)references; \
        (void)first; \
        (void)second; \
        return refuse_any(instance, count, #call ": this FMU has no clocks"); \
    }

NO_INTERVALS(GetIntervalDecimal, double *, int *)
NO_INTERVALS(GetShiftFraction, uint64_t *, uint64_t *)
NO_INTERVALS(SetShiftFraction, const uint64_t *, const uint64_t *)
NO_INTERVALS(SetIntervalFraction, const uint64_t *, const uint64_t *)

EXPORT status_t FMI(GetIntervalFraction)(void *instance, const uint32_t *references, size_t count,
    uint64_t *counters, uint64_t *resolutions, int *qualifiers)
{
    (void)references;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return refuse_any(instance, count, "GetIntervalFraction: this FMU has no clocks");
}

/* ------------------------------------------------------------------------- saved states */

{% endblock %}
{% block step %}
/* --------------------------------------------------------------------------------- step */

EXPORT status_t FMI(DoStep)(void *instance, double point, double size, bool keeps_no_state,
    bool *needs_event, bool *terminates, bool *returned_early, double *last_time)
{
    {{ name }}_fmu_t *fmu = fmu_of(instance);
    const bool success = {{ name }}_fmu_step(fmu, point, size);

    (void)keeps_no_state;
    *needs_event = false;
    *terminates = false;
    *returned_early = false;
    *last_time = fmu->memory.values[0];
    return status_of(success);
}

/* ------------------------------------------------------------------- what is not offered */

#define NO_MODE(call, why) \
    EXPORT status_t FMI(call)(void *instance) \
    { \
        return refuse(instance, #call ": this FMU has no " why); \
    }

NO_MODE(EnterEventMode, "event mode")
NO_MODE(EnterStepMode, "event mode")
NO_MODE(EvaluateDiscreteStates, "event mode")
NO_MODE(EnterConfigurationMode, "structural parameters")
NO_MODE(ExitConfigurationMode, "structural parameters")
NO_MODE(EnterContinuousTimeMode, "model exchange")

EXPORT status_t FMI(UpdateDiscreteStates)(void *instance, bool *needs_update, bool *terminates,
    bool *nominals_changed, bool *values_changed, bool *has_next_event, double *next_event)
{
    (void)needs_update;
    (void)terminates;
    (void)nominals_changed;
    (void)values_changed;
    (void)has_next_event;
    (void)next_event;
    return refuse(instance, "UpdateDiscreteStates: this FMU has no event mode");
}

EXPORT status_t FMI(GetOutputDerivatives)(void *instance, const uint32_t *references, size_t count,
    const int32_t *orders, double *values, size_t value_count)
{
    (void)references;
    (void)orders;
    (void)values;
    (void)value_count;
    return refuse_any(instance, count, "GetOutputDerivatives: this FMU gives no derivatives");
}

#define NO_DERIVATIVES(call) \
    EXPORT status_t FMI(call)(void *instance, const uint32_t *unknowns, size_t unknown_count, \
        const uint32_t *knowns, size_t known_count, const double *seed, size_t seed_count, \
        double *sensitivity, size_t sensitivity_count) \
    { \
        (void)unknowns; \
        (void)unknown_count; \
        (void)knowns; \
        (void)known_count; \
        (void)seed; \
        (void)seed_count; \
        (void)sensitivity; \
        (void)sensitivity_count; \
        return refuse(instance, #call ": this FMU gives no derivatives"); \
    }

NO_DERIVATIVES(GetDirectionalDerivative)
NO_DERIVATIVES(GetAdjointDerivative)

EXPORT status_t FMI(GetNumberOfVariableDependencies)(void *instance, uint32_t reference,
    size_t *count)
{
    (void)reference;
    (void)count;
    return refuse(instance, "GetNumberOfVariableDependencies: modelDescription.xml has them");
}

EXPORT status_t FMI(GetVariableDependencies)(void *instance, uint32_t dependent,
    size_t *elements_of_dependent, uint32_t *independents, size_t *elements_of_independents,
    int *kinds, size_t count)
{
    (void)dependent;
    (void)elements_of_dependent;
    (void)independents;
    (void)elements_of_independents;
    (void)kinds;
    (void)count;
    return refuse(instance, "GetVariableDependencies: modelDescription.xml has them");
}

/* Some importers load all functions of the standard, also those for FMUs of other kinds. */
static status_t refuse_exchange(void *instance)
{
    return refuse(instance, "this FMU is for co-simulation only");
}

EXPORT status_t FMI(SetTime)(void *instance, double time)
{
    (void)time;
    return refuse_exchange(instance);
}

EXPORT status_t FMI(CompletedIntegratorStep)(void *instance, bool keeps_no_state,
    bool *enters_events, bool *terminates)
{
    (void)keeps_no_state;
    (void)enters_events;
    (void)terminates;
    return refuse_exchange(instance);
}

#define NO_EXCHANGE(call, type) \
    EXPORT status_t FMI(call)(void *instance, type values, size_t count) \
    { \
        (void)values; \
        (void)count; \
        return refuse_exchange(instance); \
    }

NO_EXCHANGE(SetContinuousStates, const double *)
NO_EXCHANGE(GetContinuousStates, double *)
NO_EXCHANGE(GetContinuousStateDerivatives, double *)
NO_EXCHANGE(GetNominalsOfContinuousStates, double *)
NO_EXCHANGE(GetEventIndicators, double *)

EXPORT status_t FMI(GetNumberOfContinuousStates)(void *instance, size_t *count)
{
    (void)count;
    return refuse_exchange(instance);
}

EXPORT status_t FMI(GetNumberOfEventIndicators)(void *instance, size_t *count)
{
    (void)count;
    return refuse_exchange(instance);
}

EXPORT status_t FMI(ActivateModelPartition)(void *instance, uint32_t clock, double time)
{
    (void)clock;
    (void)time;
    return refuse_exchange(instance);
}
{% endblock %}
