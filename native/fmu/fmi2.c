/* FMI 2.0 for co-simulation: the functions of the standard, each of which gives a status and a line in the log. */
#include "host.h"

#include <string.h>

typedef int fmi2Status;
typedef unsigned int fmi2Reference;
typedef const char *fmi2Text, *Text;
typedef char Byte;
typedef int Boolean;
typedef void (*fmi2Logger)(void *, fmi2Text, fmi2Status, fmi2Text, fmi2Text, ...);
typedef struct {
    fmi2Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, fmi2Status);
    void *environment;
} fmi2Callbacks;

#define FMI(name, ...) FMI_NAMED(name, __VA_ARGS__)
#define FMI_NAMED(name, ...)                                                                                           \
    EXPORT fmi2Status fmi2##name(__VA_ARGS__);                                                                         \
    fmi2Status fmi2##name(__VA_ARGS__)

static void told(const instance *i, int status, const char *category, const char *message)
{
    ((fmi2Logger)i->logger)(i->environment, i->name, status, category, message);
}

EXPORT fmi2Text fmi2GetTypesPlatform(void);
fmi2Text fmi2GetTypesPlatform(void) { return "default"; }
EXPORT fmi2Text fmi2GetVersion(void);
fmi2Text fmi2GetVersion(void) { return "2.0"; }

EXPORT instance *fmi2Instantiate(fmi2Text, int, fmi2Text, fmi2Text, const fmi2Callbacks *, int, int);
instance *fmi2Instantiate(fmi2Text name, int type, fmi2Text guid, fmi2Text uri, const fmi2Callbacks *callbacks,
                          int visible, int logging)
{
    instance about = {0};
    (void)visible;
    about.tell = told;
    about.format = 1;
    if (callbacks) {
        about.logger = (void (*)(void))callbacks->logger;
        about.environment = callbacks->environment;
    }
    return type == 1 ? instance_new(&about, name, guid, uri, logging) : NULL; /* 1: co-simulation */
}

EXPORT void fmi2FreeInstance(instance *);
void fmi2FreeInstance(instance *i)
{
    if (i) instance_free(i);
}

#define STATE FMUstate
#define READ_STATE DeSerializeFMUstate
#include "both.h"

/* --- phases ---------------------------------------------------------------------------------------------------------- */

FMI(SetupExperiment, instance *i, int tolerance_defined, double tolerance, double start, int stop_defined, double stop)
{
    NEEDS_INSTANCE;
    (void)tolerance_defined, (void)tolerance;
    OR_REFUSED(component_set_up(i->c, start, stop_defined, stop), STATUS_ERROR);
}

FMI(EnterInitializationMode, instance *i)
{
    NEEDS_INSTANCE;
    OR_REFUSED(component_enter(i->c), STATUS_ERROR);
}

FMI(DoStep, instance *i, double t, double h, int no_set_prior)
{
    NEEDS_INSTANCE;
    (void)no_set_prior;
    return step_status(i, component_step(i->c, t, h));
}

FMI(CancelStep, instance *i) { return unsupported(i, "fmi2CancelStep"); }

/* --- values ---------------------------------------------------------------------------------------------------------- */

FMI(GetReal, instance *i, const fmi2Reference vr[], size_t n, double value[])
{
    NEEDS_INSTANCE;
    OR_REFUSED(given(i, n, vr, value) && component_read(i->c, vr, n, REAL, value), STATUS_ERROR);
}

FMI(SetReal, instance *i, const fmi2Reference vr[], size_t n, const double value[])
{
    NEEDS_INSTANCE;
    OR_REFUSED(given(i, n, vr, value) && component_write(i->c, vr, n, REAL, value), STATUS_ERROR);
}

FMI(GetInteger, instance *i, const fmi2Reference vr[], size_t n, int value[])
{
    NEEDS_INSTANCE;
    double x;
    if (!given(i, n, vr, value)) return refused(i, STATUS_ERROR);
    for (size_t k = 0; k < n; k++) {
        if (!component_read(i->c, vr + k, 1, ENUMERATION, &x)) return refused(i, STATUS_ERROR);
        value[k] = (int)x;
    }
    return STATUS_OK;
}

FMI(SetInteger, instance *i, const fmi2Reference vr[], size_t n, const int value[])
{
    NEEDS_INSTANCE;
    double x;
    if (!given(i, n, vr, value)) return refused(i, STATUS_ERROR);
    for (size_t k = 0; k < n; k++) {
        x = value[k];
        if (!component_write(i->c, vr + k, 1, ENUMERATION, &x)) return refused(i, STATUS_ERROR);
    }
    return STATUS_OK;
}

#define ABSENT(name, type)                                                                                             \
    FMI(Get##name, instance *i, const fmi2Reference vr[], size_t n, type value[])                                     \
    {                                                                                                                  \
        NEEDS_INSTANCE;                                                                                                \
        OR_REFUSED(given(i, n, vr, value) && component_read(i->c, vr, n, OTHER, NULL), STATUS_ERROR);                  \
    }                                                                                                                  \
    FMI(Set##name, instance *i, const fmi2Reference vr[], size_t n, const type value[])                               \
    {                                                                                                                  \
        NEEDS_INSTANCE;                                                                                                \
        OR_REFUSED(given(i, n, vr, value) && component_write(i->c, vr, n, OTHER, NULL), STATUS_ERROR);                 \
    }
ABSENT(Boolean, int)
ABSENT(String, fmi2Text)

FMI(GetDirectionalDerivative, instance *i, const fmi2Reference unknown[], size_t n, const fmi2Reference known[], size_t m,
     const double change[], double found[])
{
    NEEDS_INSTANCE;
    OR_REFUSED(given(i, n, unknown, found) && given(i, m, known, change) &&
                   component_derivative(i->c, unknown, n, known, m, change, found), STATUS_ERROR);
}

/* --- status, and what there is not ------------------------------------------------------------------------------------- */

FMI(GetRealStatus, instance *i, int kind, double *value)
{
    if (!i || kind != 2 || !value) return unsupported(i, "fmi2GetRealStatus of another kind than fmi2LastSuccessfulTime");
    *value = i->c->numbers[i->c->numbers[READY] != 0.0 ? TIME : T0];
    return STATUS_OK;
}

FMI(GetBooleanStatus, instance *i, int kind, int *value)
{
    if (!i || kind != 3 || !value) return unsupported(i, "fmi2GetBooleanStatus of another kind than fmi2Terminated");
    *value = i->failed; /* a host that asks and goes on would repeat the same step for ever */
    return STATUS_OK;
}

#define NOTHING(name, ...)                                                                                             \
    EXPORT fmi2Status fmi2##name(instance *i, __VA_ARGS__);                                                            \
    fmi2Status fmi2##name(instance *i, __VA_ARGS__) { return unsupported(i, "fmi2" #name); }
#define NOTHING_MORE(name)                                                                                             \
    EXPORT fmi2Status fmi2##name(instance *i);                                                                         \
    fmi2Status fmi2##name(instance *i) { return unsupported(i, "fmi2" #name); }
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NOTHING(GetStatus, int kind, fmi2Status *value)
NOTHING(GetIntegerStatus, int kind, int *value)
NOTHING(GetStringStatus, int kind, fmi2Text *value)
NOTHING(SetRealInputDerivatives, const fmi2Reference vr[], size_t n, const int order[], const double value[])
NOTHING(GetRealOutputDerivatives, const fmi2Reference vr[], size_t n, const int order[], double value[])

/* of model exchange */
NOTHING_MORE(EnterEventMode)
NOTHING(NewDiscreteStates, void *info)
NOTHING_MORE(EnterContinuousTimeMode)
NOTHING(CompletedIntegratorStep, int no_set_prior, int *event, int *terminate)
NOTHING(SetTime, double t)
NOTHING(SetContinuousStates, const double x[], size_t n)
NOTHING(GetDerivatives, double x[], size_t n)
NOTHING(GetEventIndicators, double x[], size_t n)
NOTHING(GetContinuousStates, double x[], size_t n)
NOTHING(GetNominalsOfContinuousStates, double x[], size_t n)
