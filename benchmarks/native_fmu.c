/* A C host of an FMU 2.0 for co-simulation: native_fmu LIBRARY GUID RESOURCES STEPS INPUT LAW OUTPUT ...
 *
 * Value references: of the inflow, of inlet.interpolation, and of the outputs that are read. Prints CPU times [s]: from
 * loading the library to the end of the first step, and of a step of 1 ms with its input set and its outputs read; and
 * the memory of the process beside that of one instance [bytes].
 */
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

typedef void *C;
typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

static void heard(void *e, const char *name, int status, const char *category, const char *text, ...)
{
    (void)e, (void)name, (void)category;
    fprintf(stderr, "%d %s\n", status, text);
}

static double cpu(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double resident(void)
{
    long pages = 0, shared;
    FILE *const file = fopen("/proc/self/statm", "r");
    if (!file || fscanf(file, "%ld %ld", &shared, &pages) != 2) exit(3);
    fclose(file);
    return (double)pages * (double)sysconf(_SC_PAGESIZE);
}

static void must(int status)
{
    if (status) exit(4);
}


int main(int argc, char **argv)
{
    static const Callbacks callbacks = {heard, calloc, free, NULL, NULL};
    static double values[4096];
    static unsigned outputs[4096];
    const int n = argc - 7, smooth = 2;
    const double start = cpu();
    void *const library = dlopen(argv[1], RTLD_NOW);
    if (n < 1 || !library) return 2;
    C (*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
    int (*step)(C, double, double, int), (*get)(C, const unsigned *, size_t, double *);
    int (*set)(C, const unsigned *, size_t, const double *);
    *(void **)&instantiate = dlsym(library, "fmi2Instantiate");
    *(void **)&step = dlsym(library, "fmi2DoStep");
    *(void **)&get = dlsym(library, "fmi2GetReal");
    *(void **)&set = dlsym(library, "fmi2SetReal");
    int (*set_up)(C, int, double, double, int, double), (*phase)(C), (*choose)(C, const unsigned *, size_t, const int *);
    *(void **)&set_up = dlsym(library, "fmi2SetupExperiment");
    *(void **)&choose = dlsym(library, "fmi2SetInteger");
    const unsigned input = (unsigned)atoi(argv[5]), law = (unsigned)atoi(argv[6]);
    for (int i = 0; i < n; i++) outputs[i] = (unsigned)atoi(argv[7 + i]);
    const double empty = resident();
    C const c = instantiate("bench", 1, argv[2], argv[3], &callbacks, 0, 1);
    if (!c) return 3;
    must(set_up(c, 0, 0.0, 0.0, 0, 0.0));
    must(choose(c, &law, 1, &smooth));
    *(void **)&phase = dlsym(library, "fmi2EnterInitializationMode");
    must(phase(c));
    *(void **)&phase = dlsym(library, "fmi2ExitInitializationMode");
    must(phase(c));
    must(step(c, 0.0, 1e-3, 1));
    const double cold = cpu() - start, memory = resident() - empty, begun = cpu();
    const int steps = atoi(argv[4]);
    for (int i = 1; i <= steps; i++) {
        const double Q = 55e-6 * fmax(0.0, sin(2.0 * M_PI * (i + 1) * 1e-3 / 0.5));
        must(set(c, &input, 1, &Q));
        must(step(c, i * 1e-3, 1e-3, 1));
        must(get(c, outputs, (size_t)n, values));
    }
    printf("%.9g %.9g %.9g\n", cold, (cpu() - begun) / steps, memory);
    return 0;
}
