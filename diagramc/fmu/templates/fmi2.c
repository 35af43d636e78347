{% extends "fmi.c" %}
{% set fmi, instance = 2, "component" %}
{% set State, Deserialize, byte = "state", "DeSerialize", "char" %}
{% block types %}
typedef void (*logger_t)(void *environment, const char *instance, status_t status,
    const char *category, const char *message, ...);

typedef struct {
    logger_t logger;
    void *(*allocate)(size_t count, size_t size);
    void (*release)(void *memory);
    void (*step_finished)(void *environment, status_t status);
    void *environment;
} callbacks_t;

typedef struct {
    {{ name }}_fmu_t fmu;
    logger_t logger;
    void *environment;
    char *name;
} component_t;

{% endblock %}
{% block report %}
static void report(void *owner, const char *text)
{
    const component_t *component = owner;

    if (component->logger != NULL) {
        component->logger(component->environment, component->name, FMI2_ERROR, "logStatusError",
            text);
    }
}

{% endblock %}
{% block start %}
EXPORT const char *FMI(GetTypesPlatform)(void)
{
    return "default";
}

EXPORT const char *FMI(GetVersion)(void)
{
    return "2.0";
}

/* Errors are always reported, and there is nothing else to report. */
EXPORT status_t FMI(SetDebugLogging)(void *component, int on, size_t count,
    const char *const categories[])
{
    (void)component;
    (void)on;
    (void)count;
    (void)categories;
    return FMI2_OK;
}

EXPORT void FMI(FreeInstance)(void *component)
{
    if (component != NULL) {
        free(((component_t *)component)->name);
        free(component);
    }
}

EXPORT void *FMI(Instantiate)(const char *name, int type, const char *guid, const char *resources,
    const callbacks_t *callbacks, int visible, int logging)
{
    const char *const shown = ((name == NULL) || (name[0] == '\0')) ? "{{ name }}" : name;
    const char *wrong = NULL;
    component_t *component = calloc(1U, sizeof *component);

    (void)resources;
    (void)visible;
    (void)logging;
    if (component == NULL) {
        return NULL;
    }
    if (callbacks != NULL) {
        component->logger = callbacks->logger;
        component->environment = callbacks->environment;
    }
    component->fmu.report = report;
    component->fmu.owner = component;
    component->name = malloc(strlen(shown) + 1U);
    if (component->name == NULL) {
        free(component);
        return NULL;
    }
    (void)strcpy(component->name, shown);
    if (shown != name) {
        wrong = "instance name: must not be empty";
    } else if (type != 1) {
        wrong = "FMU type: must be co-simulation";
    } else if ((guid == NULL) || (strcmp(guid, {{ NAME }}_TOKEN) != 0)) {
        wrong = "GUID: must be " {{ NAME }}_TOKEN ", that of this FMU";
    }
    if (wrong != NULL) {
        report(component, wrong);
        FMI(FreeInstance)(component);
        return NULL;
    }
    {{ name }}_fmu_reset(&component->fmu);
    return component;
}

/* The integrator has steps of a fixed size: a tolerance changes nothing. */
EXPORT status_t FMI(SetupExperiment)(void *component, int has_tolerance, double tolerance, double start,
    int has_stop, double stop)
{
    (void)has_tolerance;
    (void)tolerance;
    return status_of({{ name }}_fmu_set_times(fmu_of(component), start, has_stop != 0, stop));
}

EXPORT status_t FMI(EnterInitializationMode)(void *component)
{
    return status_of({{ name }}_fmu_enter_initialization(fmu_of(component)));
}

{% endblock %}
{% block values %}
EXPORT status_t FMI(GetReal)(void *component, const unsigned int *references, size_t count,
    double *values)
{
    return status_of({{ name }}_fmu_get(fmu_of(component), references, count, values));
}

EXPORT status_t FMI(SetReal)(void *component, const unsigned int *references, size_t count,
    const double *values)
{
    return status_of({{ name }}_fmu_set(fmu_of(component), references, count, values));
}

#define NO_VARIABLES(call, type) \
    EXPORT status_t FMI(call)(void *component, const unsigned int *references, size_t count, \
        type values) \
    { \
        (void)references; \
        (void)values; \
        return refuse_any(component, count, #call ": this FMU has Real variables only"); \
    }

NO_VARIABLES(GetInteger, int *)
NO_VARIABLES(SetInteger, const int *)
NO_VARIABLES(GetBoolean, int *)
NO_VARIABLES(SetBoolean, const int *)
NO_VARIABLES(GetString, const char **)
NO_VARIABLES(SetString, const char *const *)

{% endblock %}
{% block step %}
EXPORT status_t FMI(GetDirectionalDerivative)(void *component, const unsigned int *unknowns,
    size_t unknown_count, const unsigned int *knowns, size_t known_count, const double *seed,
    double *sensitivity)
{
    (void)unknowns;
    (void)unknown_count;
    (void)knowns;
    (void)known_count;
    (void)seed;
    (void)sensitivity;
    return refuse(component, "GetDirectionalDerivative: this FMU gives no derivatives");
}

EXPORT status_t FMI(SetRealInputDerivatives)(void *component, const unsigned int *references,
    size_t count, const int *orders, const double *values)
{
    (void)references;
    (void)orders;
    (void)values;
    return refuse_any(component, count, "SetRealInputDerivatives: inputs are held over a step");
}

EXPORT status_t FMI(GetRealOutputDerivatives)(void *component, const unsigned int *references,
    size_t count, const int *orders, double *values)
{
    (void)references;
    (void)orders;
    (void)values;
    return refuse_any(component, count,
        "GetRealOutputDerivatives: this FMU gives no derivatives");
}

EXPORT status_t FMI(DoStep)(void *component, double point, double size, int keeps_no_state)
{
    (void)keeps_no_state;
    return status_of({{ name }}_fmu_step(fmu_of(component), point, size));
}

EXPORT status_t FMI(CancelStep)(void *component)
{
    return refuse(component, "CancelStep: no step is pending, DoStep ends before it returns");
}

EXPORT status_t FMI(GetStatus)(void *component, int kind, status_t *value)
{
    (void)kind;
    (void)value;
    return refuse(component, "GetStatus: no step is pending, DoStep ends before it returns");
}

/* Kind 2 asks for the end time of the last successful step. */
EXPORT status_t FMI(GetRealStatus)(void *component, int kind, double *value)
{
    if (kind != 2) {
        return refuse(component, "GetRealStatus: must ask for the last successful time");
    }
    *value = fmu_of(component)->memory.values[0];
    return FMI2_OK;
}

EXPORT status_t FMI(GetIntegerStatus)(void *component, int kind, int *value)
{
    (void)kind;
    (void)value;
    return refuse(component, "GetIntegerStatus: there is no such status");
}

/* Kind 3 asks whether the FMU wants to end the simulation. */
EXPORT status_t FMI(GetBooleanStatus)(void *component, int kind, int *value)
{
    if (kind != 3) {
        return refuse(component, "GetBooleanStatus: must ask whether the FMU is terminated");
    }
    *value = 0;
    return FMI2_OK;
}

EXPORT status_t FMI(GetStringStatus)(void *component, int kind, const char **value)
{
    (void)kind;
    (void)value;
    return refuse(component, "GetStringStatus: no step is pending");
}
{% endblock %}
