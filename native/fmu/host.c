/* Instances: their log, their saved states, and the path of their resources. */
#include "host.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const CATEGORIES[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError",
                                         "logStatusFatal"};
static const char MAGIC[8] = {'A', 'R', 'T', 'S', 'T', 'A', 'T', 'E'};

typedef struct {
    char magic[8];
    uint64_t count, digest; /* numbers that follow; of these */
    char guid[64];
} head;

void tell(const instance *i, int status, const char *message)
{
    char line[2 * ROOM + 600];
    size_t at = 0;
    const char *const parts[] = {i->name, ": ", message};
    if (!i->tell || !i->logger || !i->logging || !(i->hears >> status & 1)) return;
    for (int k = 0; k < 3; k++)
        for (const char *s = parts[k]; *s && at < sizeof(line) - 3; s++) {
            line[at++] = *s;
            if (*s == '%' && i->format) line[at++] = '%';
        }
    line[at] = 0;
    i->tell(i, status, CATEGORIES[status], line);
}

int refused(const instance *i, int status)
{
    tell(i, status, i->c->said);
    return status;
}

int step_status(instance *i, int done)
{
    i->failed = done == 0;
    if (done <= 0) return refused(i, STATUS_ERROR), done < 0 ? STATUS_ERROR : STATUS_DISCARD;
    if (i->c->remark[0]) tell(i, STATUS_WARNING, i->c->remark);
    return STATUS_OK;
}

int unsupported(const instance *i, const char *function)
{
    if (i) {
        say(i->c, "%s: FMI function not supported.", function);
        refused(i, STATUS_ERROR);
    }
    return STATUS_ERROR;
}

int given(instance *i, size_t n, const void *one, const void *two)
{
    if (n == 0 || (one && two)) return 1;
    return say(i->c, "%lu values, but no memory for them (null pointer).", (unsigned long)n);
}

instance *instance_new(const instance *about, const char *name, const char *guid, const char *folder, int logging)
{
    char why[ROOM] = "", *const path = folder ? malloc(strlen(folder) + 1) : NULL;
    instance *const i = calloc(1, sizeof(instance));
    if (!i) return free(path), NULL;
    *i = *about;
    i->logging = 1;
    i->hears = ~0;
    snprintf(i->name, sizeof(i->name), "%s", name && *name ? name : "arterial");
    if (path)
        i->c = component_new(path_of(strcpy(path, folder)), guid ? guid : "", why, sizeof(why));
    else
        snprintf(why, sizeof(why), "the path of the resources is missing (null pointer).");
    free(path);
    if (!i->c) {
        tell(i, STATUS_ERROR, why);
        free(i);
        return NULL;
    }
    i->logging = logging;
    return i;
}

void instance_free(instance *i)
{
    while (i->states) {
        saved *const next = i->states->next;
        free(i->states);
        i->states = next;
    }
    component_free(i->c);
    free(i);
}

int set_logging(instance *i, int on, size_t n, const char *const *categories)
{
    int hears = n ? 0 : ~0;
    if (!given(i, n, categories, categories)) return refused(i, STATUS_ERROR);
    for (size_t k = 0; k < n; k++) {
        const char *const name = categories[k] ? categories[k] : "(null pointer)";
        int known = -1;
        for (int status = 0; status < 5; status++)
            if (!strcmp(name, CATEGORIES[status])) known = status;
        if (known < 0) {
            say(i->c, "log category %.80s: there is none of this name.", name);
            return refused(i, STATUS_ERROR);
        }
        hears |= known ? 1 << known : ~0;
    }
    i->logging = on;
    i->hears = hears;
    return STATUS_OK;
}

/* --- saved states -------------------------------------------------------------------------------------------------- */

static size_t bytes_of(const instance *i) { return sizeof(double) * (size_t)i->c->n_numbers; }

static int no(instance *i, const char *why)
{
    say(i->c, "%s", why);
    return refused(i, STATUS_ERROR);
}

/* Where a state of this instance hangs; NULL for what is none. */
static saved **held(instance *i, const void *state)
{
    for (saved **at = &i->states; *at; at = &(*at)->next)
        if (*at == state) return at;
    say(i->c, "the state is not one of this instance; give one that it saved, or write it as bytes and read these.");
    return NULL;
}

static saved *hung(instance *i)
{
    saved *const s = malloc(sizeof(saved) + bytes_of(i));
    if (!s) return say(i->c, "no memory."), NULL;
    s->next = i->states;
    return i->states = s;
}

int state_get(instance *i, void **state)
{
    if (!state) return no(i, "no memory for the state (null pointer).");
    saved *const s = *state && held(i, *state) ? *state : hung(i);
    if (!s) return refused(i, STATUS_ERROR);
    memcpy(s->numbers, i->c->numbers, bytes_of(i));
    *state = s;
    return STATUS_OK;
}

int state_set(instance *i, void *state)
{
    if (!held(i, state)) return refused(i, STATUS_ERROR);
    memcpy(i->c->numbers, ((saved *)state)->numbers, bytes_of(i));
    i->c->stepped = 0;
    i->failed = 0;
    return STATUS_OK;
}

int state_free(instance *i, void **state)
{
    if (!state || !*state) return STATUS_OK;
    saved **const at = held(i, *state);
    if (!at) return refused(i, STATUS_ERROR);
    *at = (*at)->next;
    free(*state);
    *state = NULL;
    return STATUS_OK;
}

int state_size(instance *i, void *state, size_t *size)
{
    if (!size) return no(i, "no memory for the size (null pointer).");
    if (!held(i, state)) return refused(i, STATUS_ERROR);
    *size = sizeof(head) + bytes_of(i);
    return STATUS_OK;
}

int state_write(instance *i, void *state, char *bytes, size_t size)
{
    head h = {{0}, (uint64_t)i->c->n_numbers, 0, {0}};
    if (!held(i, state)) return refused(i, STATUS_ERROR);
    if (!bytes || size < sizeof(head) + bytes_of(i))
        return no(i, "too little memory for the state; give that of the size of a serialized state.");
    h.digest = digest(((saved *)state)->numbers, bytes_of(i));
    memcpy(h.magic, MAGIC, sizeof(MAGIC));
    snprintf(h.guid, sizeof(h.guid), "%s", i->c->r.guid);
    memcpy(bytes, &h, sizeof(h));
    memcpy(bytes + sizeof(h), ((saved *)state)->numbers, bytes_of(i));
    return STATUS_OK;
}

static const char DAMAGED[] = "incomplete or damaged; give all bytes of the serialized state and no more.";

static int bad_bytes(instance *i, size_t size, const char *why)
{
    say(i->c, "state of %lu bytes: %s", (unsigned long)size, why);
    return refused(i, STATUS_ERROR);
}

int state_read(instance *i, const char *bytes, size_t size, void **state)
{
    head h;
    if (!state || !bytes) return no(i, "no bytes, or no memory for the state (null pointer).");
    if (size >= sizeof(h)) memcpy(&h, bytes, sizeof(h));
    if (size < sizeof(h) || memcmp(h.magic, MAGIC, sizeof(MAGIC)))
        return bad_bytes(i, size, "not a saved state of an FMU of this project; save one anew.");
    h.guid[sizeof(h.guid) - 1] = 0;
    if (strcmp(h.guid, i->c->r.guid)) {
        say(i->c, "state of the FMU %.64s: this one is %.64s; restore it there, or save one anew.", h.guid, i->c->r.guid);
        return refused(i, STATUS_ERROR);
    }
    if (size != sizeof(h) + bytes_of(i) || h.count != (uint64_t)i->c->n_numbers) return bad_bytes(i, size, DAMAGED);
    saved *const s = hung(i);
    if (!s) return refused(i, STATUS_ERROR);
    memcpy(s->numbers, bytes + sizeof(h), bytes_of(i));
    if (digest(s->numbers, bytes_of(i)) != h.digest || !component_may_be(i->c, s->numbers)) {
        i->states = s->next;
        free(s);
        return bad_bytes(i, size, DAMAGED);
    }
    *state = s;
    return STATUS_OK;
}

/* --- paths ---------------------------------------------------------------------------------------------------------- */

static int digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    c |= 32;
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

const char *path_of(char *uri)
{
    static const char SCHEME[] = "file:";
    char *s = uri, *to = uri;
    for (; s - uri < (int)sizeof(SCHEME) - 1; s++)
        if ((*s | 32) != (SCHEME[s - uri] | 32)) return uri; /* a path as it is */
    if (s[0] == '/' && s[1] == '/') /* a host may follow: this one, or none */
        for (s += 2; *s && *s != '/'; s++) {}
    for (; *s; s++)
        if (*s == '%' && digit(s[1]) >= 0 && digit(s[2]) >= 0) {
            *to++ = (char)(16 * digit(s[1]) + digit(s[2]));
            s += 2;
        } else {
            *to++ = *s;
        }
    *to = 0;
#if defined(_WIN32)
    if (uri[0] == '/' && uri[1] && uri[2] == ':') return uri + 1; /* /C:/… */
#endif
    return uri;
}
