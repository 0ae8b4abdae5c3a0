/* Random calls of every function of FMI 3.0: see native_fuzz.h. */
#include "native_fuzz.h"

#include "fmi3Functions.h" /* of the standard, as FMPy brings it */

static unsigned vr[MOST];

static void heard(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment;
    if (!category || !message || !*message || status < fmi3OK || status > fmi3Fatal) abort();
    lines++;
}

static fmi3Instance made(const char *folder, const char *guid)
{
    const char *const token = any(9) ? guid : any(2) ? "{}" : NULL;
    const char *const path = any(20) ? folder : any(2) ? damaged() : NULL, *const name = any(5) ? "fuzzed 100%" : NULL;
    fmi3LogMessageCallback const log = any(9) ? heard : NULL;
    const bool visible = any(2), logging = any(9);
    if (!any(10) && fmi3InstantiateModelExchange(name, token, path, visible, logging, NULL, log)) abort();
    if (!any(10) && fmi3InstantiateScheduledExecution(name, token, path, visible, logging, NULL, log, NULL, NULL, NULL))
        abort(); /* the FMU is for co-simulation */
    if (strcmp(fmi3GetVersion(), "3.0")) abort();
    return fmi3InstantiateCoSimulation(name, token, path, visible, logging, any(2), any(2), any(2) ? vr : NULL,
                                       any(MOST), NULL, log, NULL);
}

#define EITHER(number, name, type, value)                                                                              \
    case number: {                                                                                                     \
        type values[MOST];                                                                                             \
        for (size_t j = 0; j < MOST; j++) values[j] = (type)(value);                                                   \
        return any(2) ? fmi3Get##name(c, v, n, LAST(m, values), m) : fmi3Set##name(c, v, n, LAST(m, values), m);       \
    }

/* Values of types of which the FMU has no variable. */
static int of_other_types(fmi3Instance c, size_t n, size_t m)
{
    const fmi3ValueReference *const v = any(30) ? vr : NULL;
    static const fmi3Byte bytes[MOST];
    switch (any(12)) {
    EITHER(0, Float32, fmi3Float32, any(2) ? 1e-3 : NAN)
    EITHER(1, Int8, fmi3Int8, any(256))
    EITHER(2, UInt8, fmi3UInt8, any(256))
    EITHER(3, Int16, fmi3Int16, any(65536))
    EITHER(4, UInt16, fmi3UInt16, any(65536))
    EITHER(5, Int32, fmi3Int32, any(UINT32_MAX))
    EITHER(6, UInt32, fmi3UInt32, any(UINT32_MAX))
    EITHER(7, UInt64, fmi3UInt64, whole_number())
    EITHER(8, Boolean, fmi3Boolean, any(2))
    EITHER(9, String, fmi3String, any(3) ? (any(2) ? "%s\xff\xfe" : "") : NULL)
    case 10: {
        size_t sizes[MOST] = {0};
        fmi3Binary values[MOST];
        for (size_t j = 0; j < MOST; j++) values[j] = any(2) ? bytes : NULL;
        return any(2) ? fmi3GetBinary(c, v, n, any(30) ? sizes : NULL, any(30) ? values : NULL, m)
                      : fmi3SetBinary(c, v, n, any(30) ? sizes : NULL, any(30) ? values : NULL, m);
    }
    default: {
        fmi3Clock values[MOST] = {fmi3ClockInactive};
        return any(2) ? fmi3GetClock(c, v, n, any(30) ? values : NULL) : fmi3SetClock(c, v, n, any(30) ? values : NULL);
    }
    }
}

/* What the standard has for other kinds of FMUs. */
static int of_other_kinds(fmi3Instance c, size_t n, size_t m)
{
    const fmi3ValueReference *const v = any(30) ? vr : NULL;
    double numbers[MOST], *const x = any(30) ? numbers : NULL;
    fmi3UInt64 counts[MOST] = {0}, *const k = any(30) ? counts : NULL;
    size_t sizes[MOST] = {0}, *const s = any(30) ? sizes : NULL;
    fmi3Boolean flags[5], *const b = any(30) ? flags : NULL;
    fmi3Int32 orders[MOST] = {0};
    fmi3IntervalQualifier qualifiers[MOST];
    fmi3DependencyKind kinds[MOST];
    fmi3ValueReference others[MOST];
    for (size_t j = 0; j < MOST; j++) numbers[j] = number();
    switch (any(30)) {
    case 0: return fmi3GetNumberOfVariableDependencies(c, vr[0], s);
    case 1: return fmi3GetVariableDependencies(c, vr[0], s, others, s, kinds, n);
    case 2: return fmi3GetAdjointDerivative(c, v, n, v, n, x, m, x, m);
    case 3: return fmi3GetOutputDerivatives(c, v, n, orders, x, m);
    case 4: return fmi3EnterConfigurationMode(c);
    case 5: return fmi3ExitConfigurationMode(c);
    case 6: return fmi3EnterEventMode(c);
    case 7: return fmi3EnterStepMode(c);
    case 8: return fmi3EnterContinuousTimeMode(c);
    case 9: return fmi3EvaluateDiscreteStates(c);
    case 10: return fmi3UpdateDiscreteStates(c, b, b, b, b, b, x);
    case 11: return fmi3CompletedIntegratorStep(c, any(2), b, b);
    case 12: return fmi3SetTime(c, number());
    case 13: return fmi3SetContinuousStates(c, x, n);
    case 14: return fmi3GetContinuousStates(c, x, n);
    case 15: return fmi3GetContinuousStateDerivatives(c, x, n);
    case 16: return fmi3GetNominalsOfContinuousStates(c, x, n);
    case 17: return fmi3GetEventIndicators(c, x, n);
    case 18: return fmi3GetNumberOfEventIndicators(c, s);
    case 19: return fmi3GetNumberOfContinuousStates(c, s);
    case 20: return fmi3GetIntervalDecimal(c, v, n, x, qualifiers);
    case 21: return fmi3GetIntervalFraction(c, v, n, k, k, qualifiers);
    case 22: return fmi3GetShiftDecimal(c, v, n, x);
    case 23: return fmi3GetShiftFraction(c, v, n, k, k);
    case 24: return fmi3SetIntervalDecimal(c, v, n, x);
    case 25: return fmi3SetIntervalFraction(c, v, n, k, k);
    case 26: return fmi3SetShiftDecimal(c, v, n, x);
    case 27: return fmi3SetShiftFraction(c, v, n, k, k);
    default: return fmi3ActivateModelPartition(c, vr[0], number());
    }
}

/* After a step all outputs, ports too, can be read and are finite. */
static void look(fmi3Instance c)
{
    for (unsigned one = given; one < given + outputs; one++) {
        double x;
        if (fmi3GetFloat64(c, &one, 1, &x, 1) || !isfinite(x)) abort();
    }
}

int main(int argc, char **argv)
{
    fmi3Instance instance[MANY] = {NULL};
    fmi3FMUState state[STATES] = {NULL};
    double at[MANY] = {0.0}, values[MOST];
    fmi3Int64 integers[MOST];
    const char *texts[MOST] = {NULL};
    int fine = 0, steps = 0, derived = 0;
    arguments(argc, argv);
    for (long k = 0; k < calls; k++) {
        const size_t i = any(MANY), s = any(STATES), n = any(MOST), m = any(20) ? n : any(MOST);
        const size_t few = n > 0, m_few = any(20) ? few : m;
        const fmi3ValueReference *const v = any(30) ? vr : NULL;
        int status = fmi3OK;
        if (!instance[i]) {
            instance[i] = made(argv[1], argv[2]);
            at[i] = 0.0;
            continue;
        }
        fmi3Instance const c = any(50) ? instance[i] : NULL;
        for (size_t j = 0; j < MOST; j++) { /* the last variable is time */
            vr[j] = any(20) ? (unsigned)any(given + outputs + 5) : (unsigned)any(UINT32_MAX);
            values[j] = number();
            integers[j] = any(2) ? 1 + (int)any(3) : whole_number();
        }
        switch (any(26)) {
        case 0: if (!any(10)) { fmi3FreeInstance(c); if (c) instance[i] = NULL; } break;
        case 1:
            status = fmi3EnterInitializationMode(c, any(2), number(), any(2) ? 0.0 : number(), any(2), number());
            break;
        case 2: case 3: status = fmi3ExitInitializationMode(c); break;
        case 4: if (!any(10)) status = fmi3Terminate(c); break;
        case 5: if (!any(10)) { status = fmi3Reset(c); at[i] = 0.0; } break;
        case 6: case 7: case 8: {
            const unsigned clock = given + outputs;
            const double h = any(4) ? 2e-3 : number(), t = any(9) ? at[i] : number();
            bool flags[3];
            double last;
            if (h > 0.05) break; /* long ones are only slow */
            if (c && fmi3GetFloat64(c, &clock, 1, &at[i], 1)) abort();
            status = fmi3DoStep(c, any(2) ? at[i] : t, h, any(2), any(30) ? flags : NULL, any(30) ? flags + 1 : NULL,
                                any(30) ? flags + 2 : NULL, any(30) ? &last : NULL);
            if (status == fmi3OK && steps++ % 4 == 0) look(c);
            break;
        }
        case 9: case 10: status = fmi3GetFloat64(c, v, n, LAST(m, values), m); break;
        case 11: status = fmi3SetFloat64(c, v, few, LAST(m_few, values), m_few); break;
        case 12: { /* what is allowed: another value of an inflow, or of a parameter */
            const unsigned one = (unsigned)any(given);
            if (!fmi3GetFloat64(c, &one, 1, values, 1)) {
                values[0] *= changed();
                status = fmi3SetFloat64(c, &one, 1, values, 1);
            }
            break;
        }
        case 13: status = fmi3GetInt64(c, v, n, LAST(m, integers), m); break;
        case 14:
            vr[0] = (unsigned)any(any(2) ? given : given + outputs + 5);
            status = fmi3SetInt64(c, v, few, LAST(m_few, integers), m_few);
            break;
        case 15: status = of_other_types(c, n, m); break;
        case 16: status = of_other_kinds(c, n, m); break;
        case 17: status = fmi3GetFMUState(c, any(30) ? &state[s] : NULL); break;
        case 18: status = fmi3SetFMUState(c, any(30) ? state[s] : (void *)&seed); break;
        case 19: { /* of which a copy is freed, too, and then used */
            fmi3FMUState copy = state[s];
            status = fmi3FreeFMUState(c, any(30) ? any(3) ? &state[s] : &copy : NULL);
            break;
        }
        case 20: case 21: {
            size_t size = 0;
            void *back = NULL;
            if (fmi3SerializedFMUStateSize(c, state[s], any(30) ? &size : NULL) || !size) break;
            fmi3Byte *const bytes = malloc(size);
            status = fmi3SerializeFMUState(c, state[s], any(30) ? bytes : NULL, any(9) ? size : any(size));
            if (!any(3)) bytes[any(any(2) ? size : 100)] ^= (fmi3Byte)(1 + any(255));
            if (!status)
                status = fmi3DeserializeFMUState(c, any(30) ? bytes : NULL, any(5) ? size : any(size),
                                                 any(30) ? &back : NULL);
            if (!status && back) status = fmi3SetFMUState(c, back) + fmi3FreeFMUState(c, &back);
            free(bytes);
            break;
        }
        case 22: { /* of an output by what may have a derivative; of anything */
            const unsigned one = given + (unsigned)any(outputs), other = (unsigned)any(given);
            const size_t found = any(20) ? n : m;
            status = any(2) ? fmi3GetDirectionalDerivative(c, &one, 1, &other, 1, values, 1, values, 1)
                            : fmi3GetDirectionalDerivative(c, v, n, any(9) ? vr : NULL, n, LAST(m, values), m,
                                                           LAST(found, values), found);
            derived += status == fmi3OK;
            break;
        }
        case 23: status = fmi3SetDebugLogging(c, any(9), n ? 1 : 0, any(2) ? texts : NULL); break;
        default:
            if (!any(20)) for (int j = 0; j < MANY; j++) { /* begin anew, so that steps are reached */
                if (!instance[j] || fmi3Reset(instance[j])) continue;
                at[j] = 0.0;
                fmi3EnterInitializationMode(instance[j], false, 0.0, 0.0, false, 0.0);
                fmi3ExitInitializationMode(instance[j]);
            }
        }
        fine += status == fmi3OK;
    }
    for (size_t i = 0; i < MANY; i++) fmi3FreeInstance(instance[i]);
    summary(fine, steps, derived);
    return 0;
}
