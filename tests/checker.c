/* A co-simulation host of FMI 2.0 in C: reads one command a line, answers each with one line.
 *
 * It knows nothing of Python and of the FMU but what the standard says (FMI for Model Exchange and Co-Simulation 2.0.3).
 * Numbers are read and printed so that no bit is lost. Commands, L a library, I an instance, S a saved state (small
 * numbers), V a value reference:
 *
 *   library L PATH | close L                load the FMU's binary, answers version and platform; unload it
 *   instantiate I L LOGGING GUID URI | logging I ON CATEGORY ...
 *   setup I START STOP | enter I | exit I | step I T H | terminate I | reset I | free I
 *   getReal I V ... | setReal I V VALUE ... | likewise Integer, Boolean
 *   getString I V | setString I V TEXT
 *   save I S | restore I S | restoreNothing I | forget I S
 *   write I S FILE | read I S FILE          the state as bytes, to a file and back
 *   derivatives I V ORDER VALUE | directional I UNKNOWN KNOWN
 *   ask I V                                 at the FMU's next message read V, which FMI forbids
 *   wait SECONDS
 *
 * Answers: "STATUS value ..." with the name of the status; the FMU's messages come before, as "log STATUS CATEGORY TEXT".
 */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#define NOGDI /* its macro ERROR */
#include <windows.h>
#define dlopen(path, how) library_at(path)
#define dlsym(handle, name) ((void *)GetProcAddress((HMODULE)(handle), name))
#define dlclose(handle) (!FreeLibrary((HMODULE)(handle)))
#define dlerror() "Windows does not load this library"
static void *library_at(const char *path) {
    wchar_t wide[MAX_PATH];
    return MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, MAX_PATH) ? (void *)LoadLibraryW(wide) : NULL;
}
static unsigned sleep(unsigned seconds) { return Sleep(1000 * seconds), 0; }
static char *strsep(char **line, const char *ends) {
    char *const found = *line;
    if (!found) return NULL;
    *line = strpbrk(found, ends);
    if (*line) *(*line)++ = 0;
    return found;
}
#else
#include <dlfcn.h>
#include <unistd.h>
#endif

#define MANY 4096 /* values in one call, libraries, instances, states */
#define LINE 65536

typedef void *Component, *State;
typedef unsigned int Reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef void (*Logger)(void *, const char *, Status, const char *, const char *, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, Status);
    void *environment;
} Callbacks;

static const char *const STATUS[] = {"ok", "warning", "discard", "error", "fatal", "pending"};

/* One row for each function: its name in the standard, and its arguments. */
#define FUNCTIONS(F)                                                                                              \
    F(const char *, GetVersion, (void))                                                                           \
    F(const char *, GetTypesPlatform, (void))                                                                     \
    F(Component, Instantiate, (const char *, int, const char *, const char *, const Callbacks *, int, int))       \
    F(void, FreeInstance, (Component))                                                                            \
    F(Status, SetDebugLogging, (Component, int, size_t, const char *const[]))                                     \
    F(Status, SetupExperiment, (Component, int, double, double, int, double))                                     \
    F(Status, EnterInitializationMode, (Component))                                                               \
    F(Status, ExitInitializationMode, (Component))                                                                \
    F(Status, Terminate, (Component))                                                                             \
    F(Status, Reset, (Component))                                                                                 \
    F(Status, DoStep, (Component, double, double, int))                                                           \
    F(Status, GetReal, (Component, const Reference[], size_t, double[]))                                          \
    F(Status, GetInteger, (Component, const Reference[], size_t, int[]))                                          \
    F(Status, GetBoolean, (Component, const Reference[], size_t, int[]))                                          \
    F(Status, GetString, (Component, const Reference[], size_t, const char *[]))                                  \
    F(Status, SetReal, (Component, const Reference[], size_t, const double[]))                                    \
    F(Status, SetInteger, (Component, const Reference[], size_t, const int[]))                                    \
    F(Status, SetBoolean, (Component, const Reference[], size_t, const int[]))                                    \
    F(Status, SetString, (Component, const Reference[], size_t, const char *const[]))                             \
    F(Status, GetFMUstate, (Component, State *))                                                                  \
    F(Status, SetFMUstate, (Component, State))                                                                    \
    F(Status, FreeFMUstate, (Component, State *))                                                                 \
    F(Status, SerializedFMUstateSize, (Component, State, size_t *))                                               \
    F(Status, SerializeFMUstate, (Component, State, char[], size_t))                                              \
    F(Status, DeSerializeFMUstate, (Component, const char[], size_t, State *))                                    \
    F(Status, SetRealInputDerivatives, (Component, const Reference[], size_t, const int[], const double[]))       \
    F(Status, GetDirectionalDerivative,                                                                           \
      (Component, const Reference[], size_t, const Reference[], size_t, const double[], double[]))

typedef struct {
    void *handle;
#define MEMBER(result, name, arguments) result(*name) arguments;
    FUNCTIONS(MEMBER)
} Library;

typedef struct {
    Component component;
    const Library *of;
} Instance;

static Library libraries[MANY];
static Instance instances[MANY];
static State states[MANY];
static Instance asked;
static Reference wanted;

static void stop(const char *reason, const char *what) {
    fprintf(stderr, "checker: %s: %s\n", what, reason);
    exit(2);
}

static void log_message(void *environment, const char *instance, Status status, const char *category,
                        const char *message, ...) {
    char text[LINE];
    va_list arguments;
    (void)environment, (void)instance;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    for (char *c = text; *c; c++)
        if (*c == '\n' || *c == '\r') *c = ' ';
    printf("log %s %s %s\n", STATUS[status], category ? category : "-", text);
    if (asked.component) {
        Instance it = asked;
        double value = 0.0;
        asked.component = NULL;
        status = it.of->GetReal(it.component, &wanted, 1, &value);
        printf("log %s asked %.17g\n", STATUS[status], value);
    }
}

static const Callbacks callbacks = {log_message, calloc, free, NULL, NULL};

static void load(Library *library, const char *path) {
    library->handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library->handle) stop(dlerror(), "library");
#define LOAD(result, name, arguments)                                      \
    *(void **)&library->name = dlsym(library->handle, "fmi2" #name);                \
    if (!library->name) stop("the binary has no such function", "fmi2" #name);
    FUNCTIONS(LOAD)
    printf("ok %s %s\n", library->GetVersion(), library->GetTypesPlatform());
}

/* The next word of the line, or NULL at its end. */
static char *word(char **line) {
    char *found;
    while ((found = strsep(line, " ")) && !*found) continue;
    return found;
}

static char *must(char **line) {
    char *found = word(line);
    if (!found) stop("arguments are missing", "command");
    return found;
}

static int index_of(char **line) {
    int i = atoi(must(line));
    if (i < 0 || i >= MANY) stop("number out of range", "command");
    return i;
}

static void answer(Status status) { printf("%s\n", STATUS[status]); }

/* getReal, setInteger, ... : references, and values where they are set. */
static void exchange(const char *command, Instance it, char *line) {
    static Reference references[MANY];
    static double reals[MANY];
    static int integers[MANY];
    int set = command[0] == 's', real = !strcmp(command + 3, "Real");
    size_t n = 0;
    Status status;
    for (char *next; n < MANY && (next = word(&line)); n++) {
        references[n] = (Reference)strtoul(next, NULL, 10);
        if (set && real) reals[n] = strtod(must(&line), NULL);
        if (set && !real) integers[n] = atoi(must(&line));
    }
    if (real)
        status = set ? it.of->SetReal(it.component, references, n, reals)
                     : it.of->GetReal(it.component, references, n, reals);
    else if (!strcmp(command + 3, "Integer"))
        status = set ? it.of->SetInteger(it.component, references, n, integers)
                     : it.of->GetInteger(it.component, references, n, integers);
    else
        status = set ? it.of->SetBoolean(it.component, references, n, integers)
                     : it.of->GetBoolean(it.component, references, n, integers);
    printf("%s", STATUS[status]);
    for (size_t i = 0; !set && status == OK && i < n; i++) printf(real ? " %.17g" : " %.0f", real ? reals[i] : integers[i]);
    printf("\n");
}

static void text(const char *command, Instance it, char *line) {
    Reference reference = (Reference)strtoul(must(&line), NULL, 10);
    const char *value = line ? line : "";
    Status status = command[0] == 's' ? it.of->SetString(it.component, &reference, 1, &value)
                                      : it.of->GetString(it.component, &reference, 1, &value);
    printf("%s%s%s\n", STATUS[status], command[0] == 'g' && status == OK ? " " : "",
           command[0] == 'g' && status == OK ? value : "");
}

static void write_state(Instance it, State state, const char *path) {
    size_t size = 0;
    Status status = it.of->SerializedFMUstateSize(it.component, state, &size);
    char *bytes = malloc(size ? size : 1);
    if (status == OK) status = it.of->SerializeFMUstate(it.component, state, bytes, size);
    if (status == OK) {
        FILE *file = fopen(path, "wb");
        if (!file || fwrite(bytes, 1, size, file) != size || fclose(file)) stop("cannot be written", path);
    }
    free(bytes);
    printf("%s %zu\n", STATUS[status], size);
}

static void read_state(Instance it, State *state, const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file) stop("cannot be read", path);
    fseek(file, 0, SEEK_END);
    size_t size = (size_t)ftell(file);
    rewind(file);
    char *bytes = malloc(size ? size : 1);
    if (fread(bytes, 1, size, file) != size) stop("cannot be read", path);
    fclose(file);
    answer(it.of->DeSerializeFMUstate(it.component, bytes, size, state));
    free(bytes);
}

static void directional(Instance it, char *line) {
    Reference unknown = (Reference)index_of(&line), known = (Reference)index_of(&line);
    double seed = 1.0, value = 0.0;
    Status status = it.of->GetDirectionalDerivative(it.component, &unknown, 1, &known, 1, &seed, &value);
    printf("%s %.17g\n", STATUS[status], value);
}

static void instantiate(Instance *it, char *line) {
    it->of = &libraries[index_of(&line)];
    int logging = atoi(must(&line));
    const char *guid = must(&line), *uri = must(&line);
    it->component = it->of->Instantiate("checked", 1 /* co-simulation */, guid, uri, &callbacks, 0, logging);
    printf(it->component ? "ok\n" : "null\n");
}

static Status choose_logging(Instance it, char *line) {
    static const char *categories[MANY];
    int on = index_of(&line);
    size_t n = 0;
    for (char *next; n < MANY && (next = word(&line)); n++) categories[n] = next;
    return it.of->SetDebugLogging(it.component, on, n, categories);
}

static void obey(char *line) {
    const char *command = must(&line);
    if (!strcmp(command, "wait")) {
        for (unsigned left = (unsigned)index_of(&line); left;) left = sleep(left); /* a signal that is ignored wakes it */
        printf("ok\n");
        return;
    }
    int i = index_of(&line);
    if (!strcmp(command, "library")) { load(&libraries[i], line); return; }
    if (!strcmp(command, "close")) { printf(dlclose(libraries[i].handle) ? "error\n" : "ok\n"); return; }
    if (!strcmp(command, "instantiate")) { instantiate(&instances[i], line); return; }
    Instance it = instances[i];
    if (!it.component) stop("there is no such instance", command);
    if (!strcmp(command, "logging")) answer(choose_logging(it, line));
    else if (!strcmp(command, "setup")) {
        double start = strtod(must(&line), NULL), end = strtod(must(&line), NULL);
        answer(it.of->SetupExperiment(it.component, 0, 0.0, start, 1, end));
    } else if (!strcmp(command, "enter")) answer(it.of->EnterInitializationMode(it.component));
    else if (!strcmp(command, "exit")) answer(it.of->ExitInitializationMode(it.component));
    else if (!strcmp(command, "terminate")) answer(it.of->Terminate(it.component));
    else if (!strcmp(command, "reset")) answer(it.of->Reset(it.component));
    else if (!strcmp(command, "free")) {
        it.of->FreeInstance(it.component);
        instances[i].component = NULL;
        printf("ok\n");
    } else if (!strcmp(command, "step")) {
        double t = strtod(must(&line), NULL), h = strtod(must(&line), NULL);
        answer(it.of->DoStep(it.component, t, h, 1));
    } else if (!strcmp(command, "getString") || !strcmp(command, "setString")) text(command, it, line);
    else if (!strncmp(command, "get", 3) || !strncmp(command, "set", 3)) exchange(command, it, line);
    else if (!strcmp(command, "save")) answer(it.of->GetFMUstate(it.component, &states[index_of(&line)]));
    else if (!strcmp(command, "restore")) answer(it.of->SetFMUstate(it.component, states[index_of(&line)]));
    else if (!strcmp(command, "restoreNothing")) answer(it.of->SetFMUstate(it.component, NULL));
    else if (!strcmp(command, "forget")) answer(it.of->FreeFMUstate(it.component, &states[index_of(&line)]));
    else if (!strcmp(command, "write")) { int s = index_of(&line); write_state(it, states[s], line); }
    else if (!strcmp(command, "read")) { int s = index_of(&line); read_state(it, &states[s], line); }
    else if (!strcmp(command, "directional")) directional(it, line);
    else if (!strcmp(command, "ask")) {
        asked = it;
        wanted = (Reference)index_of(&line);
        answer(OK);
    } else if (!strcmp(command, "derivatives")) {
        Reference reference = (Reference)index_of(&line);
        int order = index_of(&line);
        double value = strtod(must(&line), NULL);
        answer(it.of->SetRealInputDerivatives(it.component, &reference, 1, &order, &value));
    } else stop("there is no such command", command);
}

int main(void) {
    static char line[LINE];
    setvbuf(stdout, NULL, _IOLBF, 0); /* what was answered is seen, whatever comes */
    while (fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = 0;
        if (*line) obey(line);
    }
    return 0;
}
