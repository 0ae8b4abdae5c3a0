/* Random calls of every function of FMI 2.0: see native_fuzz.h. */
#include "native_fuzz.h"

#include <stdarg.h>

#include "fmi2Functions.h" /* of the standard, as FMPy brings it */

static unsigned vr[MOST];

static void heard(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                  fmi2String format, ...)
{
    char text[8192];
    va_list more;
    (void)environment;
    va_start(more, format);
    if (vsnprintf(text, sizeof(text), format, more) < 1 || !name || !category || status > fmi2Fatal) abort();
    va_end(more);
    lines++;
}

static fmi2Component made(const char *folder, const char *guid)
{
    static const fmi2CallbackFunctions callbacks = {heard, calloc, free, NULL, NULL}, silent;
    const char *const token = any(9) ? guid : any(2) ? "{}" : NULL;
    const char *const path = any(20) ? folder : any(2) ? damaged() : NULL;
    if (strcmp(fmi2GetVersion(), "2.0") || strcmp(fmi2GetTypesPlatform(), fmi2TypesPlatform)) abort();
    return fmi2Instantiate(any(5) ? "fuzzed 100%" : NULL, any(20) ? fmi2CoSimulation : fmi2ModelExchange, token, path,
                           any(9) ? &callbacks : any(2) ? &silent : NULL, (int)any(2), any(9) > 0);
}

/* Values of types of which the FMU has no variable, and what the standard has beside. */
static int of_other_kinds(fmi2Component c, size_t n)
{
    const fmi2ValueReference *const v = any(30) ? vr : NULL;
    double numbers[MOST], *const x = n ? LAST(n, numbers) : NULL;
    int integers[MOST] = {0}, *const k = n ? LAST(n, integers) : NULL;
    const char *texts[MOST] = {NULL}, **const t = n ? LAST(n, texts) : NULL;
    const fmi2StatusKind kind = (fmi2StatusKind)any(5);
    fmi2EventInfo info;
    fmi2Status found;
    for (size_t j = 0; j < MOST; j++) {
        numbers[j] = number(), integers[j] = (int)whole_number();
        texts[j] = any(3) ? (any(2) ? "%s\xff\xfe" : "") : NULL;
    }
    switch (any(22)) {
    case 0: return fmi2GetString(c, v, n, t);
    case 1: return fmi2SetString(c, v, n, t);
    case 2: return fmi2GetBoolean(c, v, n, k);
    case 3: return fmi2SetBoolean(c, v, n, k);
    case 4: return fmi2CancelStep(c);
    case 5: return fmi2GetStatus(c, kind, any(30) ? &found : NULL);
    case 6: return fmi2GetRealStatus(c, kind, x);
    case 7: return fmi2GetIntegerStatus(c, kind, k);
    case 8: return fmi2GetBooleanStatus(c, kind, k);
    case 9: return fmi2GetStringStatus(c, kind, t);
    case 10: return fmi2SetRealInputDerivatives(c, v, n, k, x);
    case 11: return fmi2GetRealOutputDerivatives(c, v, n, k, x);
    case 12: return fmi2EnterEventMode(c);
    case 13: return fmi2NewDiscreteStates(c, any(30) ? &info : NULL);
    case 14: return fmi2EnterContinuousTimeMode(c);
    case 15: return fmi2CompletedIntegratorStep(c, (int)any(2), k, k);
    case 16: return fmi2SetTime(c, number());
    case 17: return fmi2SetContinuousStates(c, x, n);
    case 18: return fmi2GetDerivatives(c, x, n);
    case 19: return fmi2GetEventIndicators(c, x, n);
    case 20: return fmi2GetContinuousStates(c, x, n);
    default: return fmi2GetNominalsOfContinuousStates(c, x, n);
    }
}

/* After a step all outputs, ports too, can be read and are finite. */
static void look(fmi2Component c)
{
    for (unsigned one = given; one < given + outputs; one++) {
        double x;
        if (fmi2GetReal(c, &one, 1, &x) || !isfinite(x)) abort();
    }
}

int main(int argc, char **argv)
{
    fmi2Component instance[MANY] = {NULL};
    fmi2FMUstate state[STATES] = {NULL};
    double at[MANY] = {0.0}, values[MOST];
    int integers[MOST], fine = 0, steps = 0, derived = 0;
    const char *texts[MOST] = {NULL};
    arguments(argc, argv);
    for (long k = 0; k < calls; k++) {
        const size_t i = any(MANY), s = any(STATES), n = any(MOST);
        int status = 0;
        if (!instance[i]) {
            instance[i] = made(argv[1], argv[2]);
            at[i] = 0.0;
            continue;
        }
        fmi2Component const c = any(50) ? instance[i] : NULL;
        for (size_t j = 0; j < MOST; j++) {
            vr[j] = any(20) ? (unsigned)any(given + outputs + 5) : (unsigned)any(UINT32_MAX);
            values[j] = number();
            integers[j] = any(2) ? 1 + (int)any(3) : (int)whole_number();
        }
        switch (any(25)) {
        case 0: if (!any(10)) { fmi2FreeInstance(c); if (c) instance[i] = NULL; } break;
        case 1:
            status = fmi2SetupExperiment(c, (int)any(2), number(), any(2) ? 0.0 : number(), (int)any(2), number());
            break;
        case 2: status = fmi2EnterInitializationMode(c); break;
        case 3: status = fmi2ExitInitializationMode(c); break;
        case 4: if (!any(10)) status = fmi2Terminate(c); break;
        case 5: if (!any(10)) { status = fmi2Reset(c); at[i] = 0.0; } break;
        case 6: case 7: case 8: {
            const double h = any(4) ? 2e-3 : number(), t = any(9) ? at[i] : number();
            if (h > 0.05) break; /* long ones are only slow */
            if (c && fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &at[i])) abort();
            status = fmi2DoStep(c, any(2) ? at[i] : t, h, (int)any(2));
            if (status == 0 && steps++ % 4 == 0) look(c);
            break;
        }
        case 9: case 10: status = fmi2GetReal(c, any(30) ? vr : NULL, n, LAST(n, values)); break;
        case 11: status = fmi2SetReal(c, any(30) ? vr : NULL, n ? 1 : 0, LAST(n ? 1 : 0, values)); break;
        case 12: { /* what is allowed: another value of an inflow, or of a parameter */
            unsigned one = (unsigned)any(given);
            if (fmi2GetReal(c, &one, 1, values)) break;
            values[0] *= changed();
            status = fmi2SetReal(c, &one, 1, values);
            break;
        }
        case 13: status = fmi2GetInteger(c, any(30) ? vr : NULL, n, LAST(n, integers)); break;
        case 14:
            vr[0] = (unsigned)any(any(2) ? given : given + outputs + 5);
            status = fmi2SetInteger(c, any(30) ? vr : NULL, n ? 1 : 0, LAST(n ? 1 : 0, integers));
            break;
        case 15: status = of_other_kinds(c, n); break;
        case 16: status = fmi2GetFMUstate(c, any(30) ? &state[s] : NULL); break;
        case 17: status = fmi2SetFMUstate(c, any(30) ? state[s] : (void *)&seed); break;
        case 18: { /* of which a copy is freed, too, and then used */
            fmi2FMUstate copy = state[s];
            status = fmi2FreeFMUstate(c, any(30) ? any(3) ? &state[s] : &copy : NULL);
            break;
        }
        case 19: case 20: {
            size_t size = 0;
            void *back = NULL;
            if (fmi2SerializedFMUstateSize(c, state[s], any(30) ? &size : NULL) || !size) break;
            char *const bytes = malloc(size);
            status = fmi2SerializeFMUstate(c, state[s], any(30) ? bytes : NULL, any(9) ? size : any(size));
            if (!any(3)) bytes[any(any(2) ? size : 100)] ^= (char)(1 + any(255));
            if (!status)
                status = fmi2DeSerializeFMUstate(c, any(30) ? bytes : NULL, any(5) ? size : any(size),
                                                 any(30) ? &back : NULL);
            if (!status && back) status = fmi2SetFMUstate(c, back) + fmi2FreeFMUstate(c, &back);
            free(bytes);
            break;
        }
        case 21: { /* of an output by what may have a derivative; of anything */
            unsigned one = given + (unsigned)any(outputs), other = (unsigned)any(given);
            status = any(2) ? fmi2GetDirectionalDerivative(c, &one, 1, &other, 1, values, values)
                            : fmi2GetDirectionalDerivative(c, vr, n, any(9) ? vr : NULL, n, values, values);
            derived += status == 0;
            break;
        }
        case 22: status = fmi2SetDebugLogging(c, any(9) > 0, n ? 1 : 0, any(2) ? texts : NULL); break;
        default:
            if (!any(20)) for (int j = 0; j < MANY; j++) { /* begin anew, so that steps are reached */
                if (!instance[j] || fmi2Reset(instance[j])) continue;
                at[j] = 0.0;
                fmi2SetupExperiment(instance[j], 0, 0.0, 0.0, 0, 0.0);
                fmi2EnterInitializationMode(instance[j]);
                fmi2ExitInitializationMode(instance[j]);
            }
        }
        fine += status == 0;
    }
    for (size_t i = 0; i < MANY; i++) fmi2FreeInstance(instance[i]);
    summary(fine, steps, derived);
    return 0;
}
