/* What both versions of FMI share: an instance with its log and its saved states. */
#ifndef ARTERIAL_HOST_H
#define ARTERIAL_HOST_H

#include "component.h"

/* The statuses of the standard, alike in both versions. */
enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR, STATUS_FATAL };

typedef struct saved {
    struct saved *next;
    double numbers[];
} saved;

typedef struct instance {
    component *c;
    saved *states;
    void *environment;
    void (*tell)(const struct instance *, int status, const char *category, const char *message);
    void (*logger)(void); /* the host's, of either version */
    int logging, hears;   /* whether it is on; bits by status */
    int format;           /* whether messages are printf formats */
    int failed;           /* whether the last step was discarded */
    char name[256];
} instance;

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif
/* NULL, with a line in the log, where there can be none. logger, tell, environment, format : of the instance. */
instance *instance_new(const instance *about, const char *name, const char *guid, const char *folder, int logging);
void instance_free(instance *i);

void tell(const instance *i, int status, const char *message);
int refused(const instance *i, int status); /* tells what the component said; returns status */
int step_status(instance *i, int done); /* log why a step failed; returns its FMI status */
int unsupported(const instance *i, const char *function);
int set_logging(instance *i, int on, size_t n, const char *const *categories);
int given(instance *i, size_t n, const void *one, const void *two); /* whether pointers are there where n > 0 */

int state_get(instance *i, void **state);
int state_set(instance *i, void *state);
int state_free(instance *i, void **state);
int state_size(instance *i, void *state, size_t *size);
int state_write(instance *i, void *state, char *bytes, size_t size);
int state_read(instance *i, const char *bytes, size_t size, void **state);

/* The path of a URI, or of a path, decoded in place. */
const char *path_of(char *uri);
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define NEEDS_INSTANCE                                                                                                 \
    if (!i) return STATUS_ERROR
#define OR_REFUSED(done, status) return (done) ? STATUS_OK : refused(i, status)
enum { OTHER = ENUMERATION + 1 }; /* types of which there is no variable */

#endif
