/* Random calls into FMI 2.0 co-simulation instances that are linked in: native_fuzz FOLDER GUID SEED CALLS GIVEN OUTPUTS.
 *
 * Any order, any numbers, null pointers, states of other instances and damaged bytes. It is compiled with sanitizers,
 * which end it at the first fault. GIVEN : how many inputs and parameters there are, before the OUTPUTS. Prints how many
 * calls were made, how many of them, of steps and of derivatives succeeded, and how many lines were logged.
 */
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void *C;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

C fmi2Instantiate(const char *, int, const char *, const char *, const Callbacks *, int, int);
void fmi2FreeInstance(C);
int fmi2SetDebugLogging(C, int, size_t, const char *const[]);
int fmi2SetupExperiment(C, int, double, double, int, double);
int fmi2EnterInitializationMode(C);
int fmi2ExitInitializationMode(C);
int fmi2Terminate(C);
int fmi2Reset(C);
int fmi2DoStep(C, double, double, int);
int fmi2GetReal(C, const unsigned[], size_t, double[]);
int fmi2SetReal(C, const unsigned[], size_t, const double[]);
int fmi2GetInteger(C, const unsigned[], size_t, int[]);
int fmi2SetInteger(C, const unsigned[], size_t, const int[]);
int fmi2GetString(C, const unsigned[], size_t, const char *[]);
int fmi2SetString(C, const unsigned[], size_t, const char *const[]);
int fmi2GetFMUstate(C, void **);
int fmi2SetFMUstate(C, void *);
int fmi2FreeFMUstate(C, void **);
int fmi2SerializedFMUstateSize(C, void *, size_t *);
int fmi2SerializeFMUstate(C, void *, char[], size_t);
int fmi2DeSerializeFMUstate(C, const char[], size_t, void **);
int fmi2GetDirectionalDerivative(C, const unsigned[], size_t, const unsigned[], size_t, const double[], double[]);
int fmi2CancelStep(C);
int fmi2GetRealStatus(C, int, double *);

enum { MANY = 3, STATES = 8, MOST = 40 };
static uint64_t seed;
static long lines;

static uint64_t any(uint64_t n)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (seed >> 11) % n;
}

static double number(void)
{
    static const double some[] = {0.0, 1.0, -1.0, 1e-3, 2e-3, 1e-5, 3e6, 1e300, -1e300, 1e-300, NAN, INFINITY, -INFINITY};
    return any(3) ? some[any(sizeof(some) / sizeof(*some))] : ldexp((double)any(1 << 20) - (1 << 19), (int)any(60) - 50);
}

static void heard(void *e, const char *name, int status, const char *category, const char *format, ...)
{
    char text[8192];
    va_list arguments;
    (void)e;
    va_start(arguments, format);
    if (vsnprintf(text, sizeof(text), format, arguments) < 1 || !name || !category || status < 0) abort();
    va_end(arguments);
    lines++;
}

int main(int argc, char **argv)
{
    static const Callbacks callbacks = {heard, calloc, free, NULL, NULL};
    C instance[MANY] = {NULL};
    void *state[STATES] = {NULL};
    double at[MANY] = {0.0}, values[MOST];
    int integers[MOST], fine = 0, steps = 0, derived = 0;
    unsigned vr[MOST];
    const char *texts[MOST] = {NULL};
    if (argc != 7) return 2;
    seed = strtoull(argv[3], NULL, 10) * 2654435761u + 88172645463325252u;
    const long calls = strtol(argv[4], NULL, 10);
    const unsigned given = (unsigned)strtoul(argv[5], NULL, 10), outputs = (unsigned)strtoul(argv[6], NULL, 10);
    for (long k = 0; k < calls; k++) {
        const size_t i = any(MANY), s = any(STATES), n = any(MOST);
        int status = 0;
        if (!instance[i]) {
            const char *const guid = any(9) ? argv[2] : any(2) ? "{}" : NULL, *const path = any(9) ? argv[1] : NULL;
            instance[i] = fmi2Instantiate(any(5) ? "fuzzed 100%" : NULL, any(20) ? 1 : 0, guid, path,
                                          any(9) ? &callbacks : NULL, 0, 1);
            at[i] = 0.0;
            continue;
        }
        C const c = any(50) ? instance[i] : NULL;
        for (size_t j = 0; j < n; j++) {
            vr[j] = any(20) ? (unsigned)any(170) : (unsigned)any(UINT32_MAX);
            values[j] = number();
            integers[j] = any(2) ? 1 + (int)any(3) : (int)(any(UINT32_MAX) - INT32_MAX);
        }
        switch (any(24)) {
        case 0: if (!any(10)) { fmi2FreeInstance(c); if (c) instance[i] = NULL; } break;
        case 1: status = fmi2SetupExperiment(c, 0, 0.0, any(2) ? 0.0 : number(), (int)any(2), number()); break;
        case 2: status = fmi2EnterInitializationMode(c); break;
        case 3: status = fmi2ExitInitializationMode(c); break;
        case 4: if (!any(10)) status = fmi2Terminate(c); break;
        case 5: if (!any(10)) { status = fmi2Reset(c); at[i] = 0.0; } break;
        case 6: case 7: case 8: {
            const double h = any(4) ? 2e-3 : number(), t = any(9) ? at[i] : number();
            if (h > 0.05) break; /* long ones are only slow */
            if (c && fmi2GetRealStatus(c, 2, &at[i])) abort();
            status = fmi2DoStep(c, any(2) ? at[i] : t, h, (int)any(2));
            steps += status == 0;
            break;
        }
        case 9: case 10: status = fmi2GetReal(c, any(30) ? vr : NULL, n, any(30) ? values : NULL); break;
        case 11: status = fmi2SetReal(c, any(30) ? vr : NULL, n ? 1 : 0, any(30) ? values : NULL); break;
        case 12: { /* what is allowed: a little more of an inflow, or of a parameter */
            unsigned one = (unsigned)any(100);
            if (!fmi2GetReal(c, &one, 1, values)) { values[0] *= 1.01; status = fmi2SetReal(c, &one, 1, values); }
            break;
        }
        case 13: status = fmi2GetInteger(c, vr, n, integers); break;
        case 14: vr[0] = any(2) ? 95 + (unsigned)any(8) : vr[0]; status = fmi2SetInteger(c, vr, n ? 1 : 0, integers); break;
        case 15: status = fmi2GetString(c, vr, n, texts) + fmi2SetString(c, vr, n, texts); break;
        case 16: status = fmi2GetFMUstate(c, any(30) ? &state[s] : NULL); break;
        case 17: status = fmi2SetFMUstate(c, any(30) ? state[s] : (void *)&seed); break;
        case 18: status = fmi2FreeFMUstate(c, any(30) ? &state[s] : NULL); break;
        case 19: case 20: {
            size_t size = 0;
            void *back = NULL;
            if (fmi2SerializedFMUstateSize(c, state[s], &size)) break;
            char *const bytes = malloc(size);
            status = fmi2SerializeFMUstate(c, state[s], bytes, any(9) ? size : any(size));
            if (!any(3)) bytes[any(any(2) ? size : 100)] ^= (char)(1 + any(255));
            if (!status) status = fmi2DeSerializeFMUstate(c, bytes, any(5) ? size : any(size), &back);
            if (!status && back) status = fmi2SetFMUstate(c, back) + fmi2FreeFMUstate(c, &back);
            free(bytes);
            break;
        }
        case 21: { /* of an output by what may have a derivative; of anything */
            unsigned one = given + (unsigned)any(outputs), other = (unsigned)any(given);
            status = any(2) ? fmi2GetDirectionalDerivative(c, &one, 1, &other, 1, values, values)
                            : fmi2GetDirectionalDerivative(c, vr, n, any(9) ? vr : NULL, n, values, values) + fmi2CancelStep(c);
            derived += status == 0;
            break;
        }
        case 22: status = fmi2SetDebugLogging(c, 1, n ? 1 : 0, any(2) ? texts : NULL); break;
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
    printf("%ld %d %d %d %ld\n", calls, fine, steps, derived, lines);
    return 0;
}
