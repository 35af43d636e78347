{# What FMI 2 and 3 share. Most signatures differ, so fmi2.c and fmi3.c fill the blocks. One file with
   conditions for both would be 25 lines shorter. #}
{{ first_line | comment }}
/* The functions of FMI {{ fmi }}.0 for co-simulation, declared here so that no header is needed. */
#include "{{ name }}_fmu.h"

#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

/* A program that compiles several FMUs from source gives the functions of each a prefix. */
#if defined(FMI{{ fmi }}_FUNCTION_PREFIX) && !defined(FMI{{ fmi }}_OVERRIDE_FUNCTION_PREFIX)
#define JOINED(a, b) a##b
#define PREFIXED(a, b) JOINED(a, b)
#define FMI(name) PREFIXED(FMI{{ fmi }}_FUNCTION_PREFIX, fmi{{ fmi }}##name)
#else
#define FMI(name) fmi{{ fmi }}##name
#endif

typedef enum { FMI{{ fmi }}_OK = 0, FMI{{ fmi }}_ERROR = 3 } status_t;
{% block types %}{% endblock %}
static status_t status_of(bool success)
{
    return success ? FMI{{ fmi }}_OK : FMI{{ fmi }}_ERROR;
}

static {{ name }}_fmu_t *fmu_of(void *{{ instance }})
{
    return &(({{ instance }}_t *){{ instance }})->fmu;
}

{% block report %}{% endblock %}
static status_t refuse(void *{{ instance }}, const char *text)
{
    return status_of({{ name }}_fmu_refuse(fmu_of({{ instance }}), text));
}

/* Refuse a call for variables of a type that this FMU lacks, unless their count is zero. */
static status_t refuse_any(void *{{ instance }}, size_t count, const char *text)
{
    return (count == 0U) ? FMI{{ fmi }}_OK : refuse({{ instance }}, text);
}

{% block start %}{% endblock %}
EXPORT status_t FMI(ExitInitializationMode)(void *{{ instance }})
{
    return status_of({{ name }}_fmu_exit_initialization(fmu_of({{ instance }})));
}

EXPORT status_t FMI(Terminate)(void *{{ instance }})
{
    return status_of({{ name }}_fmu_terminate(fmu_of({{ instance }})));
}

EXPORT status_t FMI(Reset)(void *{{ instance }})
{
    {{ name }}_fmu_reset(fmu_of({{ instance }}));
    return FMI{{ fmi }}_OK;
}

{% block values %}{% endblock %}
EXPORT status_t FMI(GetFMU{{ State }})(void *{{ instance }}, void **saved)
{
    return status_of({{ name }}_fmu_save(fmu_of({{ instance }}), saved));
}

EXPORT status_t FMI(SetFMU{{ State }})(void *{{ instance }}, void *saved)
{
    return status_of({{ name }}_fmu_restore(fmu_of({{ instance }}), saved));
}

EXPORT status_t FMI(FreeFMU{{ State }})(void *{{ instance }}, void **saved)
{
    (void){{ instance }};
    if (saved != NULL) {
        free(*saved);
        *saved = NULL;
    }
    return FMI{{ fmi }}_OK;
}

EXPORT status_t FMI(SerializedFMU{{ State }}Size)(void *{{ instance }}, void *saved, size_t *size)
{
    (void){{ instance }};
    (void)saved;
    *size = {{ name }}_fmu_serialized_size();
    return FMI{{ fmi }}_OK;
}

EXPORT status_t FMI(SerializeFMU{{ State }})(void *{{ instance }}, void *saved, {{ byte }} *bytes, size_t size)
{
    return status_of({{ name }}_fmu_serialize(fmu_of({{ instance }}), saved, bytes, size));
}

EXPORT status_t FMI({{ Deserialize }}FMU{{ State }})(void *{{ instance }}, const {{ byte }} *bytes, size_t size,{{ "\n    " if fmi == 3 else " " }}void **saved)
{
    return status_of({{ name }}_fmu_deserialize(fmu_of({{ instance }}), bytes, size, saved));
}

{% block step %}{% endblock %}
