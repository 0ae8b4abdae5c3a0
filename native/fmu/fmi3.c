/* FMI 3.0 for co-simulation, of the same variables and value references; time has the reference after the last one. */
#include "host.h"

#include <stdbool.h>
#include <string.h>

typedef int fmi3Status;
typedef uint32_t Ref;
typedef const char *Text;
typedef const uint8_t *Bytes;
typedef uint8_t Byte;
typedef bool Boolean;
typedef void (*fmi3Logger)(void *, fmi3Status, Text, Text);

#define FMI(name, ...) FMI_NAMED(name, __VA_ARGS__)
#define FMI_NAMED(name, ...)                                                                                           \
    EXPORT fmi3Status fmi3##name(__VA_ARGS__);                                                                         \
    fmi3Status fmi3##name(__VA_ARGS__)
#define NOTHING(name, ...)                                                                                             \
    FMI(name, instance *i, __VA_ARGS__) { return unsupported(i, "fmi3" #name); }
#define NOTHING_MORE(name)                                                                                             \
    FMI(name, instance *i) { return unsupported(i, "fmi3" #name); }
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

static void told(const instance *i, int status, const char *category, const char *message)
{
    ((fmi3Logger)i->logger)(i->environment, status, category, message);
}

static instance *made(Text name, Text token, Text folder, bool logging, void *environment, fmi3Logger logger)
{
    instance about = {0};
    about.tell = told;
    about.environment = environment;
    about.logger = (void (*)(void))logger;
    return instance_new(&about, name, token, folder, logging);
}

EXPORT Text fmi3GetVersion(void);
Text fmi3GetVersion(void) { return "3.0"; }

EXPORT instance *fmi3InstantiateCoSimulation(Text, Text, Text, bool, bool, bool, bool, const Ref[], size_t, void *,
                                             fmi3Logger, void (*)(void));
instance *fmi3InstantiateCoSimulation(Text name, Text token, Text folder, bool visible, bool logging, bool events,
                                      bool early, const Ref intermediate[], size_t n, void *environment,
                                      fmi3Logger logger, void (*update)(void))
{
    return made(name, token, folder, logging, environment, logger);
}

EXPORT instance *fmi3InstantiateModelExchange(Text, Text, Text, bool, bool, void *, fmi3Logger);
instance *fmi3InstantiateModelExchange(Text name, Text token, Text folder, bool visible, bool logging, void *environment,
                                       fmi3Logger logger)
{
    if (logger) logger(environment, STATUS_ERROR, "logStatusError", "model exchange: this FMU is for co-simulation.");
    return NULL;
}

EXPORT instance *fmi3InstantiateScheduledExecution(Text, Text, Text, bool, bool, void *, fmi3Logger, void (*)(void),
                                                   void (*)(void), void (*)(void));
instance *fmi3InstantiateScheduledExecution(Text name, Text token, Text folder, bool visible, bool logging,
                                            void *environment, fmi3Logger logger, void (*update)(void),
                                            void (*lock)(void), void (*unlock)(void))
{
    return fmi3InstantiateModelExchange(name, token, folder, visible, logging, environment, logger);
}

EXPORT void fmi3FreeInstance(instance *);
void fmi3FreeInstance(instance *i)
{
    if (i) instance_free(i);
}

#define STATE FMUState
#define READ_STATE DeserializeFMUState
#include "both.h"

/* --- phases ---------------------------------------------------------------------------------------------------------- */

FMI(EnterInitializationMode, instance *i, bool tolerance_defined, double tolerance, double start, bool stop_defined,
     double stop)
{
    NEEDS_INSTANCE;
    OR_REFUSED(component_set_up(i->c, start, stop_defined, stop) && component_enter(i->c), STATUS_ERROR);
}

FMI(DoStep, instance *i, double t, double h, bool no_set_prior, bool *event, bool *terminate, bool *early, double *last)
{
    NEEDS_INSTANCE;
    const int done = component_step(i->c, t, h);
    if (event) *event = false;
    if (terminate) *terminate = false;
    if (early) *early = false;
    if (last) *last = i->c->numbers[TIME];
    return step_status(i, done);
}

/* --- values ---------------------------------------------------------------------------------------------------------- */

/* Whether there are m values for n variables, which are all scalars, and memory for them. */
static int alike(instance *i, size_t n, const void *vr, size_t m, const void *value)
{
    if (n == m) return given(i, n, vr, value);
    return say(i->c, "%lu values for %lu variables: each has one.", (unsigned long)m, (unsigned long)n);
}

static double time_of(const instance *i) { return i->c->numbers[i->c->numbers[READY] != 0.0 ? TIME : T0]; }

FMI(GetFloat64, instance *i, const Ref vr[], size_t n, double value[], size_t m)
{
    NEEDS_INSTANCE;
    const Ref clock = (Ref)i->c->r.meta[N_VARIABLES];
    size_t k = 0;
    if (!alike(i, n, vr, m, value)) return refused(i, STATUS_ERROR);
    while (k < n && vr[k] != clock) k++;
    if (k == n) OR_REFUSED(component_read(i->c, vr, n, REAL, value), STATUS_ERROR);
    for (k = 0; k < n; k++) {
        if (vr[k] == clock) value[k] = time_of(i);
        else if (!component_read(i->c, vr + k, 1, REAL, value + k)) return refused(i, STATUS_ERROR);
    }
    return STATUS_OK;
}

FMI(SetFloat64, instance *i, const Ref vr[], size_t n, const double value[], size_t m)
{
    NEEDS_INSTANCE;
    OR_REFUSED(alike(i, n, vr, m, value) && component_write(i->c, vr, n, REAL, value), STATUS_ERROR);
}

FMI(GetInt64, instance *i, const Ref vr[], size_t n, int64_t value[], size_t m)
{
    NEEDS_INSTANCE;
    double x;
    if (!alike(i, n, vr, m, value)) return refused(i, STATUS_ERROR);
    for (size_t k = 0; k < n; k++) {
        if (!component_read(i->c, vr + k, 1, ENUMERATION, &x)) return refused(i, STATUS_ERROR);
        value[k] = (int64_t)x;
    }
    return STATUS_OK;
}

FMI(SetInt64, instance *i, const Ref vr[], size_t n, const int64_t value[], size_t m)
{
    NEEDS_INSTANCE;
    double x;
    if (!alike(i, n, vr, m, value)) return refused(i, STATUS_ERROR);
    for (size_t k = 0; k < n; k++) {
        x = (double)value[k];
        if (!component_write(i->c, vr + k, 1, ENUMERATION, &x)) return refused(i, STATUS_ERROR);
    }
    return STATUS_OK;
}

#define ABSENT(name, type)                                                                                             \
    FMI(Get##name, instance *i, const Ref vr[], size_t n, type value[], size_t m)                                     \
    {                                                                                                                  \
        NEEDS_INSTANCE;                                                                                                \
        OR_REFUSED(alike(i, n, vr, m, value) && component_read(i->c, vr, n, OTHER, NULL), STATUS_ERROR);              \
    }                                                                                                                  \
    FMI(Set##name, instance *i, const Ref vr[], size_t n, const type value[], size_t m)                               \
    {                                                                                                                  \
        NEEDS_INSTANCE;                                                                                                \
        OR_REFUSED(alike(i, n, vr, m, value) && component_write(i->c, vr, n, OTHER, NULL), STATUS_ERROR);             \
    }
ABSENT(Float32, float)
ABSENT(Int8, int8_t)
ABSENT(UInt8, uint8_t)
ABSENT(Int16, int16_t)
ABSENT(UInt16, uint16_t)
ABSENT(Int32, int32_t)
ABSENT(UInt32, uint32_t)
ABSENT(UInt64, uint64_t)
ABSENT(Boolean, bool)
ABSENT(String, Text)
NOTHING(GetBinary, const Ref vr[], size_t n, size_t sizes[], Bytes value[], size_t m)
NOTHING(SetBinary, const Ref vr[], size_t n, const size_t sizes[], const Bytes value[], size_t m)
NOTHING(GetClock, const Ref vr[], size_t n, bool value[])
NOTHING(SetClock, const Ref vr[], size_t n, const bool value[])

FMI(GetDirectionalDerivative, instance *i, const Ref unknowns[], size_t n, const Ref knowns[], size_t m,
     const double seed[], size_t n_seed, double found[], size_t n_found)
{
    NEEDS_INSTANCE;
    OR_REFUSED(alike(i, n, unknowns, n_found, found) && alike(i, m, knowns, n_seed, seed) &&
                   component_derivative(i->c, unknowns, n, knowns, m, seed, found), STATUS_ERROR);
}

/* --- what there is not ------------------------------------------------------------------------------------------------- */

NOTHING(GetNumberOfVariableDependencies, Ref vr, size_t *n)
NOTHING(GetVariableDependencies, Ref vr, size_t at[], Ref of[], size_t from[], int kinds[], size_t n)
NOTHING(GetAdjointDerivative, const Ref unknowns[], size_t n, const Ref knowns[], size_t m, const double seed[],
        size_t n_seed, double found[], size_t n_found)
NOTHING(GetOutputDerivatives, const Ref vr[], size_t n, const int32_t orders[], double value[], size_t m)
NOTHING_MORE(EnterConfigurationMode)
NOTHING_MORE(ExitConfigurationMode)
NOTHING_MORE(EnterEventMode)
NOTHING_MORE(EnterStepMode)
NOTHING_MORE(EnterContinuousTimeMode)
NOTHING_MORE(EvaluateDiscreteStates)
NOTHING(UpdateDiscreteStates, bool *again, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
NOTHING(CompletedIntegratorStep, bool no_set_prior, bool *event, bool *terminate)
NOTHING(SetTime, double t)
NOTHING(SetContinuousStates, const double x[], size_t n)
NOTHING(GetContinuousStates, double x[], size_t n)
NOTHING(GetContinuousStateDerivatives, double x[], size_t n)
NOTHING(GetNominalsOfContinuousStates, double x[], size_t n)
NOTHING(GetEventIndicators, double x[], size_t n)
NOTHING(GetNumberOfEventIndicators, size_t *n)
NOTHING(GetNumberOfContinuousStates, size_t *n)
NOTHING(GetIntervalDecimal, const Ref vr[], size_t n, double intervals[], int qualifiers[])
NOTHING(GetIntervalFraction, const Ref vr[], size_t n, uint64_t counters[], uint64_t resolutions[], int qualifiers[])
NOTHING(GetShiftDecimal, const Ref vr[], size_t n, double shifts[])
NOTHING(GetShiftFraction, const Ref vr[], size_t n, uint64_t counters[], uint64_t resolutions[])
NOTHING(SetIntervalDecimal, const Ref vr[], size_t n, const double intervals[])
NOTHING(SetIntervalFraction, const Ref vr[], size_t n, const uint64_t counters[], const uint64_t resolutions[])
NOTHING(SetShiftDecimal, const Ref vr[], size_t n, const double shifts[])
NOTHING(SetShiftFraction, const Ref vr[], size_t n, const uint64_t counters[], const uint64_t resolutions[])
NOTHING(ActivateModelPartition, Ref clock, double t)
